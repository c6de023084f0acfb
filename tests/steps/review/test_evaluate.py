"""Figures of a performance: right, readable by people and scripts, and able to stop a job."""

import csv
import importlib.util
import json
from pathlib import Path

import numpy as np
import pytest

from tests.steps.small_shot import FRAMES, Shot
from usdface.cli import main
from usdface.core.errors import InputError
from usdface.media.picture.image import read_image_metadata
from usdface.runner.execute import execute
from usdface.runner.job import run_job
from usdface.runner.result import StepResult
from usdface.runner.state import job_states
from usdface.specs.edits import EditsImportSpec, EditSpec
from usdface.specs.reading import read_job
from usdface.specs.review import EvaluateSpec, ReportSpec, SheetSpec
from usdface.steps.inputs.weight_tables import read_weight_table
from usdface.steps.review.scoring import read_keys
from usdface.steps.review.shot import open_shot
from usdface.usdio.performance.read import read_performance
from usdface.usdio.performance.weights_layer import make_header
from usdface.usdio.performance.write import writing_performance
from usdface.usdio.rig.read import read_rig


def spec_of(shot: Shot, **changes: object) -> EvaluateSpec:
    given: dict[str, object] = {
        "performance": shot / "shot.hero.usda",
        "against": shot / "keys.csv",
    }
    return EvaluateSpec(**(given | changes))  # type: ignore[arg-type]


@pytest.fixture(scope="module")
def usual(finished_shot: Shot) -> StepResult:
    return execute(spec_of(finished_shot))


def told(arguments: list[str], capsys: pytest.CaptureFixture[str]) -> tuple[int, str, str]:
    with pytest.raises(SystemExit) as stopped:
        main(arguments)
    captured = capsys.readouterr()
    return int(stopped.value.code or 0), captured.out, captured.err


def test_the_figures_are_those_of_the_shared_ruler(shared_data: Path, tmp_path: Path) -> None:
    source, ruler_file = shared_data / "crosstake", shared_data.parent / "tools" / "score.py"
    if not (source.is_dir() and ruler_file.is_file()):
        pytest.skip("the shared data lack crosstake or its ruler")
    found = importlib.util.spec_from_file_location("score", ruler_file)
    assert found is not None
    assert found.loader is not None
    ruler = importlib.util.module_from_spec(found)
    found.loader.exec_module(ruler)
    truth = np.load(source / "truth.npz")
    shapes = tuple(map(str, truth["shapes"]))
    weights = truth["weights"][:600].astype(np.float64)
    noise = np.random.default_rng(0).normal(0, 0.05, weights.shape)
    rig_file = shared_data / "rigs" / "facecap_head.usdc"
    with writing_performance(
        tmp_path / "p.usda",
        make_header(
            read_rig(rig_file),
            shape_names=shapes[::-1],
            rate=60,
            first_frame=101,
            last_frame=700,
        ),
        read_rig(rig_file),
    ) as writer:
        writer.append((weights + noise)[:, ::-1])
    with (tmp_path / "truth.csv").open("w", newline="", encoding="utf-8") as stream:
        rows = csv.writer(stream)
        rows.writerow(["frame", *shapes])
        rows.writerows([101 + i, *map(repr, map(float, row))] for i, row in enumerate(weights))
    figures = execute(
        EvaluateSpec(performance=tmp_path / "p.usda", against=tmp_path / "truth.csv")
    ).figures
    written = read_performance(tmp_path / "p.usda").weights.values[:, ::-1].astype(float)
    observable = np.array([not name.lower().startswith("eyelook") for name in shapes])
    expected = ruler.metrics(
        written, weights, shapes, ruler.rig_shapes(str(rig_file)), 60.0, observable
    )
    for name, value in expected.items():
        assert figures[name] == pytest.approx(value, abs=1e-9), name


def test_evaluate_sheet_and_report_lead_with_one_figure_without_gaze_and_tongue(shot: Shot) -> None:
    for name in ("eyeLookUpLeft", "tongueOut"):
        execute(EditSpec(performance=shot / "shot.hero.usda", shape=(name,), add=0.4))
    given = {"performance": shot / "shot.hero.usda", "against": shot / "keys.csv"}
    evaluated = execute(EvaluateSpec(**given, out=(shot / "e.json",)))
    figures = json.loads((shot / "e.json").read_text(encoding="utf-8"))
    mean = figures["skin_mean_mm"]
    assert figures["vertex_rms_mm"] > 2 * figures["skin_rms_mm"]
    assert evaluated.summary.startswith(f"{FRAMES} frames: {mean:.3f} mm off the keys without gaze")
    sheet = execute(SheetSpec(**given, out=shot / "x.png", tile=64, rows=1, quality="draft"))
    assert sheet.figures["mean_error_mm"]["usdface"] == pytest.approx(mean)
    execute(ReportSpec(**given, out=shot / "x.html", height=120))
    page = (shot / "x.html").read_text(encoding="utf-8")
    assert f"{mean:.3f} mm" in page
    assert f"{mean:.2f} mm off the keys" in page
    for name in ("gaze", "tongue"):
        value = figures[f"{name}_mean_mm"]
        assert value > 0
        assert sheet.figures[f"{name}_mean_mm"] == pytest.approx(value)
        assert f"{name} alone {value:.3f} mm" in evaluated.summary
        assert f"{name} alone, mean" in page
        assert f"{value:.3f} mm" in page


def test_the_table_goes_by_region_and_by_shape(usual: StepResult) -> None:
    report = usual
    first = [line.split()[0] for line in report.table if line]
    for part in ("region", "face", "brows", "lids", "cheeks", "mouth", "jaw", "lips:", "blinks"):
        assert part in first
    regions = report.figures["regions"]
    assert isinstance(regions, list)
    assert [each["region"] for each in regions] == [
        "brows",
        "lids",
        "cheeks and nose",
        "mouth",
        "jaw",
    ]
    assert json.loads(json.dumps(report.figures, allow_nan=False)) == report.figures


def test_a_performance_against_itself_is_without_error(finished_shot: Shot) -> None:
    result = execute(spec_of(finished_shot, against=finished_shot / "shot.hero.usda"))
    figures = result.figures
    assert "joints" not in str(result.notes)
    assert figures["vertex_max_mm"] == 0.0
    assert figures["weight_rmse"] == 0.0
    assert figures["jitter"] == 1.0


def test_frames_limit_what_is_measured(finished_shot: Shot) -> None:
    figures = execute(spec_of(finished_shot, frames="100-199")).figures
    assert figures["frames"] == {"count": 100, "first": 100, "last": 199}
    worst = figures["worst_frames"]
    assert isinstance(worst, list)
    assert all(100 <= frame <= 199 for frame in worst)


def test_a_table_that_ends_early_is_named(shot: Shot) -> None:
    lines = (shot / "keys.csv").read_text("utf-8").splitlines(keepends=True)
    (shot / "half.csv").write_text("".join(lines[:201]), "utf-8")
    notes = execute(spec_of(shot, against=shot / "half.csv")).notes
    assert f"half.csv has 200 of the {FRAMES} frames; the others have no keys" in notes


def test_a_truth_at_a_few_frames_is_enough(shot: Shot) -> None:
    table = read_weight_table(shot / "keys.csv")
    rows = table.weights[9:FRAMES:40]
    data = [
        {"frame": 10 + 40 * i} | dict(zip(table.names, row, strict=True))
        for i, row in enumerate(rows.tolist())
    ]
    (shot / "few.json").write_text(json.dumps(data))
    report = execute(spec_of(shot, against=shot / "few.json", out=(shot / "few.png",)))
    assert report.figures["jitter"] is None  # no four frames follow each other
    frames = report.figures["frames"]
    assert isinstance(frames, dict)
    assert frames["count"] == len(rows)


def test_keys_by_other_names_are_the_same_keys(
    finished_shot: Shot, usual: StepResult, tmp_path: Path
) -> None:
    head, rows = (finished_shot / "keys.csv").read_text(encoding="utf-8").split("\n", 1)
    frame, *names = head.strip().split(",")
    named = [
        "hero_face_bs_" + name.replace("Left", "_L").replace("Right", "_R")
        if name not in ("jawLeft", "jawRight", "mouthLeft", "mouthRight")
        else f"hero_face_bs_{name}"
        for name in names
    ]
    keys = tmp_path / "other.csv"
    keys.write_text(",".join([frame, *named]) + "\n" + rows, encoding="utf-8")
    other = execute(spec_of(finished_shot, against=keys))
    assert other.figures["vertex_rms_mm"] == pytest.approx(usual.figures["vertex_rms_mm"])
    assert other.figures["weight_rmse"] == pytest.approx(usual.figures["weight_rmse"])
    assert any("matched by the meaning" in note for note in other.notes)
    shot = open_shot(finished_shot / "shot.hero.usda", frames="1-39")
    again = [read_keys(each, shot, None, []) for each in (keys, finished_shot / "keys.csv")]
    np.testing.assert_allclose(again[0], again[1])


def test_keys_in_percent_are_the_same_keys(
    finished_shot: Shot, usual: StepResult, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    table = read_weight_table(finished_shot / "keys.csv")
    keys, performance = tmp_path / "percent.csv", finished_shot / "shot.hero.usda"
    rows = np.c_[table.frames, 100 * table.weights]
    header = ",".join(("frame", *table.names))
    np.savetxt(keys, rows, "%.17g", ",", header=header, comments="")
    with pytest.raises(InputError, match="--weight-unit percent"):
        execute(spec_of(finished_shot, against=keys))
    percent = execute(spec_of(finished_shot, against=keys, weight_unit="percent"))
    assert percent.figures["vertex_rms_mm"] == pytest.approx(usual.figures["vertex_rms_mm"])
    shot = open_shot(performance, frames="1-39")
    np.testing.assert_allclose(
        read_keys(keys, shot, "percent", []),
        read_keys(finished_shot / "keys.csv", shot, None, []),
        atol=1e-12,
    )
    with pytest.raises(InputError, match="--weight-unit is for tables of weights"):
        execute(spec_of(finished_shot, against=performance, weight_unit="one"))
    for command in ("sheet", "report"):
        out = tmp_path / ("x.png" if command == "sheet" else "x.html")
        code, _, err = told(
            [command, str(performance), "--weight-unit", "percent", "--out", str(out)], capsys
        )
        assert code == 2
        assert "weight_unit has no effect without against" in err


def test_shapes_that_markers_cannot_show_are_named(usual: StepResult) -> None:
    hidden = set(usual.figures["unobservable"])  # type: ignore[call-overload]
    assert len(hidden) == 9
    assert all(name == "tongueOut" or name.startswith("eyeLook") for name in hidden)


def test_shapes_of_one_side_count_as_0_on_the_other_and_are_told(shot: Shot) -> None:
    lines = ["frame,jawOpen,wiggle", *(f"{frame},0.5,0" for frame in range(1, FRAMES + 1))]
    (shot / "jaw.csv").write_text("\n".join(lines))
    notes = execute(spec_of(shot, against=shot / "jaw.csv")).notes
    assert any("left out 1 column of" in note and "wiggle" in note for note in notes)
    assert any("jaw.csv lacks" in note and "taken as 0" in note for note in notes)


def test_json_and_picture_say_where_they_come_from(shot: Shot) -> None:
    outputs = (shot / "error.json", shot / "error.png")
    report = execute(spec_of(shot, out=outputs))
    assert report.outputs == outputs
    data = json.loads(outputs[0].read_text(encoding="utf-8"))
    assert data["vertex_rms_mm"] == report.figures["vertex_rms_mm"]
    assert data["provenance"]["step"] == "evaluate"
    assert read_image_metadata(outputs[1])["step"] == "evaluate"
    assert execute(spec_of(shot, out=outputs)).up_to_date
    outputs[0].write_text("{}")
    with pytest.raises(InputError, match="not written by usdface"):
        execute(spec_of(shot, out=outputs[:1]))


def test_in_a_job_an_evaluation_that_writes_nothing_is_never_done(shot: Shot) -> None:
    text = "{step: evaluate, performance: shot.hero.usda, against: keys.csv}"
    (shot / "look.yaml").write_text(text)
    run_job(read_job(shot / "look.yaml"))
    assert job_states(read_job(shot / "look.yaml"))[0].state == "missing"


def other_frames(shot: Shot) -> list[str]:
    (shot / "late.csv").write_text("frame,jawOpen\n9001,0.5\n")
    return ["--against", "late.csv"]


def no_shape_in_common(shot: Shot) -> list[str]:
    (shot / "names.csv").write_text("frame,wiggle\n1,0.5\n")
    return ["--against", "names.csv"]


def frames_outside(shot: Shot) -> list[str]:
    return ["--against", "keys.csv", "--frames", "900-999"]


def other_solve(shot: Shot, name: str, weights: np.ndarray, rate: int) -> None:
    performance, rig = read_performance(shot / "shot.hero.usda"), read_rig(shot / "hero.usdc")
    header = make_header(
        rig,
        shape_names=performance.weights.names,
        rate=rate,
        first_frame=1,
        last_frame=len(weights),
    )
    with writing_performance(shot / name, header, rig) as writer:
        writer.append(weights.astype(float))


def test_of_a_table_of_takes_the_rows_of_its_take_count(shot: Shot, usual: StepResult) -> None:
    header, *rows = (shot / "keys.csv").read_text("utf-8").splitlines()
    zeros = [f"b,{row.partition(',')[0]}{',0' * row.count(',')}" for row in rows]
    lines = [f"take,{header}", *(f"shot,{row}" for row in rows), *zeros]
    both = shot / "takes.csv"
    both.write_text("\n".join(lines), "utf-8")
    solved = shot / "shot.hero.usda"
    alone = usual.figures["weight_rmse"]
    found = execute(EvaluateSpec(performance=solved, against=both))
    assert found.figures["weight_rmse"] == alone
    view = open_shot(solved, frames="1-39")
    np.testing.assert_array_equal(
        *(read_keys(each, view, None, []) for each in (shot / "keys.csv", both))
    )
    execute(EditsImportSpec(performance=solved, changed=both))
    edited = EvaluateSpec(performance=solved, against=shot / "keys.csv")
    assert execute(edited).figures["weight_rmse"] < 0.2 * alone
    both.write_text("\n".join(lines).replace("shot,", "c,"), "utf-8")
    with pytest.raises(InputError, match="none of its takes"):
        execute(EvaluateSpec(performance=solved, against=both))


def another_rate(shot: Shot) -> list[str]:
    solved = read_performance(shot / "shot.hero.usda").weights
    other_solve(shot, "slow.usda", solved.values[:5], 24)
    return ["--against", "slow.usda"]


def test_keys_of_a_still_solve_count_its_frames(shot: Shot) -> None:
    solved = read_performance(shot / "shot.hero.usda").weights
    other_solve(shot, "still.usda", np.zeros_like(solved.values), 120)
    given = EvaluateSpec(performance=shot / "still.usda", against=shot / "keys.csv")
    assert execute(given).figures["frames"]["count"] > FRAMES / 2


def rows_of_another_rate(shot: Shot) -> list[str]:
    header, *rows = (shot / "keys.csv").read_text("utf-8").splitlines()
    halved = [f"{1 + i},{row.partition(',')[2]}" for i, row in enumerate(rows[::2])]
    (shot / "film.csv").write_text("\n".join([header, *halved]), "utf-8")
    return ["--against", "film.csv"]


def wrong_ending(shot: Shot) -> list[str]:
    return ["--against", "keys.csv", "--out", "error.txt"]


@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (other_frames, ("late.csv", "9001", "have no common frame")),
        (no_shape_in_common, ("names.csv", "wiggle", "rename")),
        (frames_outside, ("have no common frame in 900-999",)),
        (another_rate, ("slow.usda", "24 frames per second", "performance's rate")),
        (rows_of_another_rate, ("film.csv", "count 60 frames per second", "not 120")),
        (wrong_ending, ("error.txt", ".json", ".png")),
    ],
)
def test_bad_input_is_told(shot: Shot, spoil, words, monkeypatch, capsys) -> None:
    arguments = spoil(shot)
    monkeypatch.chdir(shot.folder)
    code, _, err = told(["evaluate", "shot.hero.usda", *arguments], capsys)
    assert code == 2
    for word in words:
        assert word in err
