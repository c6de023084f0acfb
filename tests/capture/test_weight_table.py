"""Tables of weights as tools write them, and what must not be believed of them."""

import json
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest

from usdface.capture.sniff import read_capture, recognise_format
from usdface.capture.weight_samples import read_weight_samples
from usdface.core.errors import InputError
from usdface.core.provenance import Provenance
from usdface.steps.inputs.weight_tables import read_weight_table
from usdface.usdio.take.write import write_take

NAMES = ("jawOpen", "mouthSmileLeft", "browInnerUp")
WEIGHTS = np.random.default_rng(0).random((25, 3)).astype(np.float32)


def csv(index: str, rows: list[str], delimiter: str = ",") -> str:
    head = delimiter.join([*index.split(), *NAMES])
    lines = [
        delimiter.join([row, *(repr(float(each)) for each in weights)])
        for row, weights in zip(rows, WEIGHTS, strict=True)
    ]
    return "\n".join([head, *lines]) + "\n"


def categories(row: np.ndarray) -> list[dict[str, object]]:
    pairs = zip(("_neutral", *NAMES), (0.5, *row.tolist()), strict=True)
    return [{"index": i, "score": s, "categoryName": n} for i, (n, s) in enumerate(pairs)]


WRITTEN = {
    "frames.csv": csv("Frame", [str(101 + n) for n in range(25)]),
    "times.csv": csv("time_s", [f"{n / 30:.6f}" for n in range(25)], ";"),
    "ms.csv": csv("timestamp_ms", [f"{n * 1000 / 30:.3f}" for n in range(25)], "\t"),
    "rows.json": json.dumps(
        [
            dict(zip(("frame", *NAMES), (n + 1, *row), strict=True))
            for n, row in enumerate(WEIGHTS.tolist())
        ]
    ),
    "a2f.json": json.dumps(
        {"exportFps": 30.0, "numFrames": 25, "facsNames": NAMES, "weightMat": WEIGHTS.tolist()}
    ),
    "ict.json": json.dumps(
        {"fps": 30, "names": NAMES, "frames": [{"weights": row} for row in WEIGHTS.tolist()]}
    ),
    "numbered.json": json.dumps(
        {
            "names": NAMES,
            "frames": [
                {"frame": 101 + n, "weights": row} for n, row in enumerate(WEIGHTS.tolist())
            ],
        }
    ),
    "timed.json": json.dumps(
        {
            "names": NAMES,
            "data": [{"time": n / 30, "weights": row} for n, row in enumerate(WEIGHTS.tolist())],
        }
    ),
    "values.json": json.dumps(
        {
            "version": 3,
            "fps": 24,  # of the display: the times are those of the rows
            "names": NAMES,
            "frames": [
                {"t": n / 30, "values": row, "matrix": [1.0, 0.0]}
                for n, row in enumerate(WEIGHTS.tolist())
            ],
        }
    ),
    "mediapipe.json": json.dumps([categories(row) for row in WEIGHTS]),
    "results.json": json.dumps(
        [
            {"timestamp_ms": 1000 * n / 30, "faceBlendshapes": [categories(row)]}
            for n, row in enumerate(WEIGHTS)
        ]
    ),
    "browser.json": json.dumps(
        [
            {
                "timestamp_ms": 1000 * n / 30,
                "faceLandmarks": [[{"x": 0.5, "y": 0.5, "z": 0.0}]],
                "faceBlendshapes": [{"categories": categories(row), "headIndex": -1}],
            }
            for n, row in enumerate(WEIGHTS)
        ]
    ),
}
NO_TIMES = ("frames.csv", "rows.json", "numbered.json", "mediapipe.json")
FROM_101 = ("frames.csv", "numbered.json")


def test_values_beside_the_weights_are_named(tmp_path: Path) -> None:
    path = tmp_path / "browser.json"
    path.write_text(WRITTEN["browser.json"])
    assert "not read: faceLandmarks" in read_capture(path).notes


@pytest.mark.parametrize("name", WRITTEN)
def test_a_table_becomes_a_take_to_the_last_bit(tmp_path: Path, name: str) -> None:
    path = tmp_path / name
    path.write_text(WRITTEN[name])
    take = read_capture(path, rate=30.0 if name in NO_TIMES else None).take
    assert take.source is not None
    assert take.source.names == NAMES
    assert np.array_equal(take.source.values, WEIGHTS)
    assert take.rate == 30
    assert take.first_frame == (101 if name in FROM_101 else 1)
    write_take(tmp_path / "x.take.usda", take, provenance=Provenance())
    back = read_weight_table(tmp_path / "x.take.usda")
    assert np.array_equal(back.columns(NAMES).astype(np.float32), WEIGHTS)
    assert back.frames[0] == take.first_frame


@pytest.mark.parametrize("name", WRITTEN)
def test_keys_have_the_frames_that_the_take_of_the_same_table_has(
    tmp_path: Path, name: str
) -> None:
    path = tmp_path / name
    path.write_text(WRITTEN[name])
    take = read_capture(path, rate=30.0 if name in NO_TIMES else None).take
    table = read_weight_table(path)
    assert np.array_equal(table.columns(NAMES).astype(np.float32), WEIGHTS)
    first = take.first_frame
    assert table.frames == tuple(range(first, first + take.frame_count))
    assert table.rate in (None, 30)
    (note,) = table.notes(path, table.names, owner="on the rig") or [""]
    assert ("count from frame 1" in note) == (name not in (*FROM_101, "rows.json"))


def test_a_stated_rate_that_is_not_that_of_the_times_is_said(tmp_path: Path) -> None:
    path = tmp_path / "values.json"
    path.write_text(WRITTEN["values.json"])
    assert any(
        "states 24 frames per second, and its times 30: " in n for n in read_capture(path).notes
    )
    path.write_text(WRITTEN["values.json"].replace('"fps": 24', '"fps": 30'))
    assert not any("the times are followed" in note for note in read_capture(path).notes)


def test_keys_at_uneven_times_are_no_frames(tmp_path: Path) -> None:
    path = tmp_path / "keys.csv"
    path.write_text("time,jawOpen,smile\n0,0,0\n0.31,1,0\n0.4,0,1\n1.77,0,0\n")
    with pytest.raises(
        InputError, match=r"uneven times, which do not determine frames.*`frame` column"
    ):
        read_weight_table(path)


@pytest.mark.parametrize("title", ["time_s", "Time (s)", "seconds"])
def test_keys_seconds_apart_are_not_milliseconds_apart(tmp_path: Path, title: str) -> None:
    path = tmp_path / "keys.csv"
    path.write_text(f"{title},jawOpen,smile\n0,0,0\n1.5,1,0\n3,0,1\n")
    take = read_capture(path, rate=24).take
    assert (take.rate, take.frame_count) == (24, 73)
    assert take.source.values[36].tolist() == [1, 0]


def test_times_beside_frames_tell_the_rate_they_are_at(tmp_path: Path) -> None:
    path = tmp_path / "keys.csv"
    path.write_text("frame,time,jawOpen\n1,0.000,0\n31,1.000,1\n91,3.000,0\n")
    keys = read_weight_table(path)
    assert (keys.frames, keys.rate) == ((1, 31, 91), 30)
    with pytest.raises(InputError, match=r"runs at 30 frames per second, shot\.usda at 60"):
        keys.check_rate(Fraction(60), file=path, performance=Path("shot.usda"))
    keys.check_rate(Fraction(30_000, 1001), file=path, performance=Path("shot.usda"))
    path.write_text("frame,time,jawOpen\n1,0.5,0\n31,0.5,1\n")
    assert read_weight_table(path).rate is None


def test_each_take_of_a_table_without_numbers_counts_its_own_rows(tmp_path: Path) -> None:
    path = tmp_path / "day.csv"
    rows = [f"{'kitchen' if n < 10 else 'stairs'},{(n % 10) / 30:.6f}" for n in range(20)]
    path.write_text("\n".join(csv("take time", rows + ["x,0"] * 5).splitlines()[:21]))
    table = read_weight_table(path, take=None)
    assert table.frames == (*range(1, 11), *range(1, 11))
    assert table.rate == 30
    assert read_weight_table(path, take="stairs").frames == tuple(range(1, 11))
    with pytest.raises(InputError, match="frame 1 occurs 2 times"):
        read_weight_table(path)
    with pytest.raises(InputError, match=r"none of its takes \(kitchen, stairs\) is hall"):
        read_weight_table(path, take="hall")


def test_a_picture_without_a_face_is_a_dropped_frame(tmp_path: Path) -> None:
    path = tmp_path / "seen.json"
    rows = json.loads(WRITTEN["browser.json"])
    rows[3]["faceBlendshapes"] = []
    path.write_text(json.dumps(rows))
    capture = read_capture(path)
    assert any("1 of 25 frames were dropped" in note for note in capture.notes)
    assert capture.take.source is not None
    between = (WEIGHTS[2].astype(float) + WEIGHTS[4]) / 2
    np.testing.assert_allclose(capture.take.source.values[3], between, atol=1e-6)
    without_times = [{"faceBlendshapes": row["faceBlendshapes"]} for row in rows]
    path.write_text(json.dumps(without_times))
    assert read_weight_table(path).frames == (1, 2, 3, *range(5, 26))
    rows[3]["faceBlendshapes"] = rows[4]["faceBlendshapes"] * 2
    path.write_text(json.dumps(rows))
    with pytest.raises(InputError, match="row 4: holds 2 faces"):
        read_capture(path)


def test_a_rate_against_that_of_the_file_is_noted(tmp_path: Path) -> None:
    path = tmp_path / "a2f.json"
    path.write_text(WRITTEN["a2f.json"])
    (note,) = read_capture(path, rate=60.0).notes
    assert note == "60 frames per second, as stated; the file says 30"


def test_a_matrix_takes_its_names_from_beside_it(tmp_path: Path) -> None:
    path = tmp_path / "face.npy"
    np.save(path, WEIGHTS)
    with pytest.raises(InputError, match=r"write them, one per line, to face\.names\.txt"):
        read_capture(path, rate=25.0)
    np.save(tmp_path / "face.names.npy", np.array(NAMES))
    take = read_capture(path, rate=25.0).take
    assert take.source is not None
    assert np.array_equal(take.source.values, WEIGHTS)
    (tmp_path / "short.txt").write_text("jawOpen\nsmile\n")
    with pytest.raises(InputError, match="2 names for the 3 columns"):
        read_capture(path, rate=25.0, shapes=tmp_path / "short.txt")
    np.save(tmp_path / "objects.npy", np.array([{}, 1], object), allow_pickle=True)
    with pytest.raises(InputError, match="without pickled objects"):
        read_capture(tmp_path / "objects.npy", rate=25.0)
    with (tmp_path / "several.npy").open("wb") as stream:
        np.savez(stream, weights=WEIGHTS)
    with pytest.raises(InputError, match=r"several\.npy: is an archive of several arrays"):
        read_weight_samples(tmp_path / "several.npy")
    with pytest.raises(InputError, match=r"several\.npy: is an archive of several arrays"):
        read_capture(path, rate=25.0, shapes=tmp_path / "several.npy")


def test_a_matrix_without_rows_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "x.npy"
    np.save(path, np.zeros((0, 3)))
    (tmp_path / "x.names.txt").write_text("\n".join(NAMES))
    for read in (read_weight_table, lambda file: read_capture(file, rate=30.0)):
        with pytest.raises(InputError, match="holds no rows of weights"):
            read(path)


def test_several_takes_in_one_table_are_told_apart(tmp_path: Path) -> None:
    path = tmp_path / "day.csv"
    rows = [f"{'kitchen' if n < 10 else 'stairs'},{n}" for n in range(25)]
    path.write_text(csv("take frame", rows))
    with pytest.raises(InputError, match=r"rows of 2 takes \(kitchen, stairs\).*--take"):
        read_capture(path, rate=30.0)
    take = read_capture(path, rate=30.0, take="stairs").take
    assert (take.name, take.first_frame, take.frame_count) == ("stairs", 10, 15)
    table = read_weight_table(path)
    assert table.takes[9:11] == ("kitchen", "stairs")


@pytest.mark.parametrize(
    ("text", "options", "message"),
    [
        ("frame,jawOpen,smile\n1,40,0\n2,90,3\n", {"rate": 30.0}, "jawOpen is 90.*--weight-unit"),
        ("frame,jawOpen,smile\n1,half,0\n", {"rate": 30.0}, "line 2, column 2.*'half'"),
        ("frame,jawOpen,smile\n1,0,0\n2,0,1\n", {}, "no column of times.*--rate"),
        (
            "frame,time_s,jawOpen,smile\n1,0,0,0\n2,.04,0,0\n3,.08,0,0\n",
            {"rate": 60.0},
            "two frame rates",
        ),
        ("frame,jawOpen,jawOpen\n1,0,0\n", {"rate": 30.0}, "'jawOpen' appears twice"),
        ("frame,jawOpen,smile\n2,0,0\n1,0,0\n", {"rate": 30.0}, "must ascend"),
        (
            '[{"frame": 1, "jawOpen": "x"}]',
            {"rate": 30.0},
            "row 1, column 'jawOpen': 'x' is not a number",
        ),
        ('{"fps": 30, "facsNames": ["a", "b"], "weightMat": [[1]]}', {}, "1 weights for 2 names"),
        ('{"fps": 30, "facsNames": ["a", "a"], "weightMat": [[1, 0]]}', {}, "a is named twice"),
        ('{"fps": 30, "facsNames": [["a"]], "weightMat": [[1]]}', {}, "holds more than names"),
        (
            '[{"frame": 1, "Frame Number": 5, "a": 1}]',
            {"rate": 30.0},
            "frame and Frame Number both say frame",
        ),
    ],
)
def test_what_cannot_be_believed_is_refused(tmp_path: Path, text, options, message) -> None:
    path = tmp_path / "table.txt"
    path.write_text(text)
    with pytest.raises(InputError, match=message):
        read_capture(path, **options)


def test_percent_is_read_as_such_where_it_is_stated(tmp_path: Path) -> None:
    path = tmp_path / "percent.csv"
    path.write_text("time,jawOpen,smile\n0,40,0\n0.04,90,3\n0.08,1,100\n")
    take = read_capture(path, weight_unit="percent").take
    assert take.source is not None
    np.testing.assert_allclose(take.source.values[1], [0.9, 0.03], rtol=1e-6)
    as_written = read_capture(path, weight_unit="one").take
    assert as_written.source is not None
    assert as_written.source.values[1, 0] == 90
    with pytest.raises(InputError, match="--weight-unit percent"):
        read_weight_table_of(path)


def read_weight_table_of(path: Path) -> None:
    path.write_text(
        path.read_text().replace("time,", "frame,").replace("0.04", "1").replace("0.08", "2")
    )
    read_weight_table(path)


def test_lists_of_people_are_no_captures(tmp_path: Path) -> None:
    for name, text in {"notes.csv": "shot,note\nkitchen,good\n", "a.json": '{"job": "x"}'}.items():
        (tmp_path / name).write_text(text)
        with pytest.raises(InputError, match="not a known capture format"):
            recognise_format(tmp_path / name)
