"""What a user states of a capture is used; what cannot be is refused, and nothing is written."""

from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tests.c3d_write import write_c3d
from tests.model.placement.test_plausibility import synthetic, with_sides_exchanged
from usdface.core.assets import Markers, Take, Video, WeightsClip
from usdface.core.errors import CheckFailedError, InputError
from usdface.core.provenance import Provenance
from usdface.runner.execute import execute
from usdface.runner.result import StepResult
from usdface.specs.capture import IngestSpec
from usdface.steps.capture.ingest_folder import ingest_folder
from usdface.steps.capture.merge_captures import cut_frames, exchange_sides, padding_notes
from usdface.usdio.take.read import read_take
from usdface.usdio.take.write import write_take

RATE = 60


def write_table(
    path: Path, markers: Markers, *, scale: float = 1.0, gap: str = "", with_time: bool = True
) -> None:
    """Write a table between semicolons, with decimal commas, as spreadsheets of half of Europe."""
    titles = [f"{name}_{axis}" for name in markers.names for axis in "XYZ"]
    lines = [";".join(["Frame", *(["time_s"] if with_time else []), *titles])]
    for frame, (row, seen) in enumerate(zip(markers.positions, markers.visible, strict=True), 1):
        cells = [
            f"{scale * value:.4f}" if ok else gap
            for p, ok in zip(row, seen, strict=True)
            for value in p
        ]
        clock = [f"{(frame - 1) / RATE:.6f}"] if with_time else []
        lines.append(";".join([str(frame), *clock, *cells]).replace(".", ","))
    path.write_text("\n".join(lines), encoding="utf-8")


def ingest(source: Path, **options: object) -> tuple[Take, StepResult]:
    out = source.with_name("x.take.usda")
    report = execute(IngestSpec(sources=(source,), out=out, **options), overwrite=True)
    return read_take(out), report


def padded(markers: Markers, head: int, tail: int) -> Markers:
    """Return markers that are not seen in the first and the last frames."""
    seen = markers.visible.copy()
    seen[:head], seen[len(seen) - tail :] = False, False
    return replace(markers, visible=seen, confidence=seen.astype(np.float32))


@pytest.mark.parametrize(
    "gap", ["", "NA", "n/a", "NaN", "null", "-nan(ind)", "1.#QNAN", "-1.#IND00", "nan(snan)"]
)
def test_tables_between_semicolons_with_gaps_and_no_times(tmp_path: Path, gap: str) -> None:
    markers = padded(synthetic(frames=60), 10, 5)
    write_table(tmp_path / "x.csv", markers, gap=gap, with_time=False)
    with pytest.raises(InputError, match=r"a column time_s .*--rate"):
        ingest(tmp_path / "x.csv")
    take, report = ingest(tmp_path / "x.csv", rate=RATE)
    assert take.rate == RATE
    np.testing.assert_array_equal(take.markers.visible, markers.visible)
    seen = markers.visible
    np.testing.assert_allclose(
        take.markers.positions[seen], markers.positions[seen], rtol=0, atol=1e-3
    )
    assert any("15 frames at the ends hold no marker (1-10 and 56-60)" in n for n in report.notes)
    cut, after = ingest(tmp_path / "x.csv", rate=RATE, frames="11-55")
    assert (cut.first_frame, cut.frame_count, cut.markers.visible.all()) == (11, 45, True)
    assert not any("at the ends" in note for note in after.notes)


def test_text_that_is_no_gap_is_refused(tmp_path: Path) -> None:
    write_table(tmp_path / "x.csv", padded(synthetic(frames=60), 3, 0), gap="missing")
    with pytest.raises(InputError, match=r"line 2, column 3 .*'missing' where a number"):
        ingest(tmp_path / "x.csv")


def test_a_face_of_another_unit_is_refused_and_every_option_mends_it(tmp_path: Path) -> None:
    markers = synthetic(frames=60)
    write_table(tmp_path / "x.csv", markers, scale=0.1)
    with pytest.raises(InputError, match=r"x\.csv: the face is 0\.\d+ times .*--units cm"):
        ingest(tmp_path / "x.csv")
    assert [path.name for path in tmp_path.iterdir()] == ["x.csv"], "nothing is written"
    for options in ({"units": "cm"}, {"scale": 10.0}, {"units": "m", "scale": 0.01}):
        take, report = ingest(tmp_path / "x.csv", **options)
        np.testing.assert_allclose(take.markers.positions, markers.positions, atol=1e-2)
        assert take.warnings == ()
        assert not any("times the size" in note for note in report.notes)
    take, report = ingest(tmp_path / "x.csv", units="mm")
    assert len(take.warnings) == 1
    assert "times the size" in take.warnings[0]
    assert take.warnings[0] in report.notes


def test_exchanged_sides_are_mended_by_name_or_by_position(tmp_path: Path) -> None:
    markers = synthetic(frames=60)
    wrong = with_sides_exchanged(markers)
    write_c3d(tmp_path / "x.c3d", wrong.positions, wrong.visible, wrong.names, rate=RATE)
    with pytest.raises(InputError, match=r"left and right are exchanged: .*--mirrored labels"):
        ingest(tmp_path / "x.c3d", rigid=("NoseTop", "Leyebrow_Outside"))
    mended, _ = ingest(tmp_path / "x.c3d", rigid=("NoseTop", "Leyebrow_Outside"), mirrored="labels")
    assert mended.markers.names == markers.names
    assert mended.markers.rigid == ("NoseTop", "Reyebrow_Outside"), "the marker, not its name"
    reflected, _ = ingest(tmp_path / "x.c3d", mirrored="axes")
    assert reflected.markers.names == wrong.names
    np.testing.assert_allclose(reflected.markers.positions, wrong.positions * [-1, 1, 1])
    assert mended.warnings == reflected.warnings == ()
    kept, _ = ingest(tmp_path / "x.c3d", mirrored="no")
    assert len(kept.warnings) == 1


def test_labels_without_sides_cannot_be_exchanged() -> None:
    markers = replace(synthetic(), names=tuple(f"F{i}" for i in range(24)))
    with pytest.raises(InputError, match=r"x: no two labels differ in their side.*--mirrored axes"):
        exchange_sides(Take("x", Fraction(RATE), 1, markers), "labels", where="x")


def test_one_side_is_refused_until_it_is_stated(tmp_path: Path) -> None:
    markers = synthetic(frames=60)
    keep = [i for i, name in enumerate(markers.names) if "R" not in name]
    names = [markers.names[i] for i in keep]
    seen = markers.visible[:, keep]
    write_c3d(tmp_path / "x.c3d", markers.positions[:, keep], seen, names, rate=RATE)
    with pytest.raises(InputError, match=r"no marker is labelled on the right side"):
        ingest(tmp_path / "x.c3d")
    take, _ = ingest(tmp_path / "x.c3d", partial=True)
    assert "right side" in take.warnings[0]


def test_a_stated_rate_overrules_the_file(tmp_path: Path) -> None:
    markers = synthetic(frames=60)
    write_c3d(tmp_path / "x.c3d", markers.positions, markers.visible, markers.names, rate=6)
    take, report = ingest(tmp_path / "x.c3d", rate=59.94)
    assert take.rate == Fraction(60000, 1001)
    assert any("the file says 6 frames per second; 59.94" in note for note in report.notes)


def test_cut_frames_stay_where_they_were_in_time() -> None:
    whole = Take(
        "x",
        Fraction(30000, 1001),
        101,
        synthetic(frames=60),
        video=Video(Path("x.mov"), Fraction(24), offset=0.25),
        source=WeightsClip(
            ("jawOpen",),
            np.zeros((60, 1), np.float32),
            101,
            Fraction(30000, 1001),
            gaps=((103, 110), (118, 123), (130, 131), (140, 150), (155, 160)),
        ),
        timecode_start="00:00:59;20",
    )
    cut = cut_frames(whole, (121, 140), where="x")
    assert cut.source.gaps == ((121, 123), (130, 131), (140, 140))
    assert (cut.first_frame, cut.frame_count) == (121, 20)
    assert cut.timecode_start == "00:01:00;12", "20 frames on, of which two labels do not exist"
    taken = 7.5  # a moment of the cut, in seconds of the whole take
    assert cut.video.video_time(taken - 20 / float(whole.rate)) == pytest.approx(
        whole.video.video_time(taken)
    )
    assert 121 <= cut.markers.neutral_frame <= 140
    with pytest.raises(InputError, match=r"x: frames 90-110 are not all there; it has 101-160"):
        cut_frames(whole, (90, 110), where="x")


def test_frozen_ends_are_named() -> None:
    markers = synthetic(frames=90)
    frozen = markers.positions.copy()
    frozen[:20], frozen[80:] = frozen[20], frozen[79]
    take = Take("x", Fraction(RATE), 1, replace(markers, positions=frozen))
    (note,) = padding_notes(take)
    assert "20 frames at the ends are copies of one frame (1-20)" in note
    assert "--frames 21-90" in note, "ten frames are a sixth of a second"
    assert padding_notes(replace(take, markers=markers)) == []


def test_of_a_take_in_two_formats_one_is_chosen_and_no_folder_is_left(tmp_path: Path) -> None:
    markers = synthetic(frames=60)
    source = tmp_path / "day"
    source.mkdir()
    write_c3d(source / "a.c3d", markers.positions, markers.visible, markers.names, rate=RATE)
    write_table(source / "a.csv", markers)
    shared = IngestSpec(sources=("x",), out="x.usda")
    with pytest.raises(CheckFailedError, match=r"more than one has markers; .*--only c3d"):
        ingest_folder(source, tmp_path / "new" / "takes", shared)
    assert not (tmp_path / "new").exists()
    for only in ("c3d", "*.C3D", ".csv"):
        chosen = shared.model_copy(update={"only": only})
        report = ingest_folder(source, tmp_path / "new" / "takes", chosen, overwrite=True)
        assert report.summary == "1 take of " + str(source)
    with pytest.raises(InputError, match=r"no name of a capture matches --only trc"):
        ingest_folder(source, tmp_path / "other", shared.model_copy(update={"only": "trc"}))
    assert not (tmp_path / "other").exists()


def test_only_is_for_folders(tmp_path: Path) -> None:
    markers = synthetic(frames=60)
    write_c3d(tmp_path / "x.c3d", markers.positions, markers.visible, markers.names, rate=RATE)
    with pytest.raises(InputError, match="--only chooses among the captures of a folder"):
        ingest(tmp_path / "x.c3d", only="c3d")


def test_options_that_change_nothing_of_a_capture_are_named(tmp_path: Path) -> None:
    write_table(tmp_path / "x.csv", synthetic(frames=60))
    (tmp_path / "x.names.txt").write_text("jawOpen\n")
    _, report = ingest(tmp_path / "x.csv", weight_unit="one", shapes=tmp_path / "x.names.txt")
    assert [note for note in report.notes if "no effect" in note] == [
        f"--weight-unit has no effect: there is no table of weights in {tmp_path / 'x.csv'}",
        f"--shapes has no effect: there is no .npy table in {tmp_path / 'x.csv'}",
    ]
    (tmp_path / "x.csv").write_text("frame,jawOpen,eyeBlinkLeft\n1,0.2,0\n2,0.4,1\n")
    _, report = ingest(tmp_path / "x.csv", rate=RATE, units="cm", partial=True)
    assert [note.split(":")[0] for note in report.notes if "no effect" in note] == [
        "--units has no effect",
        "--partial has no effect",
    ]


def test_a_table_of_markers_in_other_words_is_told_its_columns(tmp_path: Path) -> None:
    for with_time in (True, False):
        write_table(tmp_path / "x.csv", synthetic(frames=60), with_time=with_time)
        text = "Bild" + (tmp_path / "x.csv").read_text(encoding="utf-8")[len("frame") :]
        (tmp_path / "x.csv").write_text(text, encoding="utf-8")
        if with_time:
            _, result = ingest(tmp_path / "x.csv")
            assert "no column is called frame: frames are numbered from 1, by their times" in (
                result.notes
            )
    with pytest.raises(InputError, match=r"it must name a column time_s.*found Bild"):
        ingest(tmp_path / "x.csv")


@pytest.mark.parametrize(
    ("option", "moved"),
    [({"scale": 2.0}, (2.0, 2.0, 2.0)), ({"mirrored": "axes"}, (-1.0, 1.0, 1.0))],
)
def test_the_head_of_a_cleaned_take_moves_with_its_markers(
    tmp_path: Path, option: dict[str, object], moved: tuple[float, float, float]
) -> None:
    head = np.tile(np.eye(4), (60, 1, 1))
    head[:, :3, :3] = Rotation.from_rotvec(np.linspace((0, 0, 0), (0.1, 0.7, 0.2), 60)).as_matrix()
    head[:, :3, 3] = np.linspace((0, 0, 0), (30, 20, 10), 60)
    markers = replace(synthetic(frames=60), space="stabilized", neutral_frame=1)
    take = Take("t", Fraction(RATE), 1, markers=markers, head_motion=head, warnings=())
    write_take(tmp_path / "t.take.usda", take, provenance=Provenance())
    back, _ = ingest(tmp_path / "t.take.usda", **option)
    assert back.markers is not None
    assert back.head_motion is not None

    def captured(motion: np.ndarray, positions: np.ndarray) -> np.ndarray:
        turned = np.einsum("fij,fmj->fmi", motion[:, :3, :3], positions)
        return np.asarray(turned + motion[:, None, :3, 3])

    found = captured(back.head_motion, back.markers.positions)
    np.testing.assert_allclose(found, captured(head, markers.positions) * moved, atol=1e-2)
