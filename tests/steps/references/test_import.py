"""Keys of people into references: which rows and shapes are taken, and what is said of others."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from pxr import Usd, UsdSkel

from tests.usdio.references.test_references import small_references, write
from usdface.core.errors import InputError
from usdface.runner.execute import execute
from usdface.runner.result import StepResult
from usdface.specs.references import ReferencesImportSpec
from usdface.usdio.references.read import read_references

PAIRS = 12


def asset(folder: Path, *, rate: float = 120.0) -> Path:
    references = small_references(folder, pairs=PAIRS, seed=1)
    return write(folder, replace(references, frames=13 * references.frames, rate=rate))


def import_rows(path: Path, rows: list[str], **given: object) -> StepResult:
    table = path.parent / "keys.csv"
    table.write_text("\n".join(rows) + "\n")
    return execute(ReferencesImportSpec(references=path, weights=table, **given), overwrite=True)


def keys_at(frames: list[int]) -> list[str]:
    return ["frame,jawOpen,eyeBlink,smile", *(f"{frame},0.5,0.25,0" for frame in frames)]


def noted(result: StepResult, start: str) -> str:
    return next((note for note in result.notes if note.startswith(start)), "")


def test_rows_at_no_pair_are_named(tmp_path: Path) -> None:
    path = asset(tmp_path)
    frames = read_references(path).frames.tolist()
    result = import_rows(path, keys_at([*frames[:9], 1, 2, 3, 4, 5, 6, 8]))
    assert result.figures["pairs"] == 9
    assert result.figures["rows"] == 16
    assert result.figures["unmatched"] == [1, 2, 3, 4, 5, 6, 8]
    note = noted(result, "not imported: 7 of 16 rows are at frames that are no pairs")
    assert "(1, 2, 3, 4, 5 and 2 more)" in note
    assert "`usdface references add`" in note
    result = import_rows(path, keys_at([1, 2, PAIRS + 1]), at="pairs")
    assert noted(result, "not imported: 1 of 3 rows have numbers of no pair (13)")


def test_a_file_of_another_rigs_names_is_refused_and_tunes_nothing(tmp_path: Path) -> None:
    path = asset(tmp_path)
    frames = read_references(path).frames.tolist()
    rows = [f"{frame},0.5,0.25,0.75,0" for frame in frames]
    with pytest.raises(InputError, match=r"2 of its 3 shapes with weights \(hat, wig\) are not on"):
        import_rows(path, ["frame,jawOpen,hat,wig,scarf", *rows])
    assert not read_references(path).tuned.any()
    few = [row.replace("0.75", "0") for row in rows]
    assert import_rows(path, ["frame,jawOpen,hat,wig,scarf", *few]).figures["shapes"] == 1


def test_pairs_that_the_range_of_a_file_misses_are_named(tmp_path: Path) -> None:
    path = asset(tmp_path)
    frames = read_references(path).frames
    late = np.sort(frames)[-3:]
    result = import_rows(path, keys_at(list(range(1, int(late[0])))))
    note = noted(result, f"not in keys.csv, whose frames are 1-{late[0] - 1}: 3 of {PAIRS} pairs")
    for pair in np.flatnonzero(frames >= late[0]):
        assert f"{pair + 1} at frame {frames[pair]}" in note
    assert not noted(import_rows(path, keys_at(frames.tolist())), "not in keys.csv")


def test_a_file_with_a_row_for_every_frame_has_no_lost_keys(tmp_path: Path) -> None:
    path = asset(tmp_path)
    result = import_rows(path, keys_at(list(range(1, 3000))))
    assert result.figures["pairs"] == PAIRS
    assert result.figures["unmatched"] == []
    assert not noted(result, "not imported")


def test_keys_that_count_at_another_rate_are_refused_with_it(tmp_path: Path) -> None:
    path = asset(tmp_path)
    before = read_references(path)
    slow = np.floor(before.frames / 5).astype(int).tolist()
    slow[0] = int(before.frames[0])  # one row is at a pair, as it may be by chance
    with pytest.raises(InputError, match=r"1 of 12 rows are at pairs, but 11 would .* 24 frames"):
        import_rows(path, keys_at(slow))
    assert not read_references(path).tuned.any()
    elsewhere = [int(before.frames[0]), *range(200, 211)]
    elsewhere[5] += 40
    assert import_rows(path, keys_at(elsewhere)).figures["pairs"] == 1


def test_usd_of_another_rate_is_refused_unless_its_time_codes_are_pairs(tmp_path: Path) -> None:
    path, keys = asset(tmp_path), tmp_path / "keys.usda"
    stage = Usd.Stage.CreateNew(str(keys))
    stage.SetTimeCodesPerSecond(24)
    animation = UsdSkel.Animation.Define(stage, "/Anim")
    animation.CreateBlendShapesAttr(["jawOpen", "eyeBlink", "smile"])
    for frame in range(1, 200):
        animation.CreateBlendShapeWeightsAttr().Set([0.5, 0.25, 0.0], frame)
    stage.Save()
    with pytest.raises(InputError, match=r"runs at 24 frames per second, .* at 120; export it"):
        execute(ReferencesImportSpec(references=path, weights=keys), overwrite=True)
    assert not read_references(path).tuned.any()
    animation.GetBlendShapeWeightsAttr().Set([0.5, 0.25, 50.0], 3)
    stage.Save()
    with pytest.raises(
        InputError, match=r"frame 3: smile is 50, and 1.5 is full .* divide its weig"
    ):
        execute(ReferencesImportSpec(references=path, weights=keys, at="pairs"), overwrite=True)
    animation.GetBlendShapeWeightsAttr().Set([0.5, 0.25, 1.5], 3)  # beyond the range, as keyed
    stage.Save()
    by_pair = ReferencesImportSpec(references=path, weights=keys, at="pairs")
    result = execute(by_pair, overwrite=True)
    assert result.figures["pairs"] == PAIRS


def test_shapes_without_a_column_are_at_rest_where_nobody_had_tuned(tmp_path: Path) -> None:
    path = asset(tmp_path)
    before = read_references(path)
    first, second = before.frames[:2].tolist()
    blink, smile = (before.shape_names.index(name) for name in ("eyeBlink", "smile"))
    result = import_rows(path, ["frame,jawOpen", f"{first},0.5"])
    after = read_references(path)
    np.testing.assert_allclose(after.weights[0], [0.5, 0.0, 0.0])
    np.testing.assert_array_equal(after.weights[1:], before.weights[1:])
    note = noted(result, "not in the file: 2 shapes, which in 1 pair not tuned before are set to 0")
    assert "--keep-proposed" in note
    larger = max((blink, smile), key=lambda column: before.weights[0, column])
    assert f"(largest: {before.shape_names[larger]} {before.weights[0, larger]:.2f}," in note

    result = import_rows(path, ["frame,eyeBlink", f"{first},0.75", f"{second},0.75"])
    after = read_references(path)
    np.testing.assert_allclose(after.weights[:2], [[0.5, 0.75, 0.0], [0.0, 0.75, 0.0]])
    assert noted(result, "not in the file: 2 shapes, which in 1 pair not tuned before")
    assert noted(result, "not in the file, so unchanged in the 1 pair tuned before: 2 shapes")


def test_proposals_of_shapes_without_a_column_are_kept_on_demand(tmp_path: Path) -> None:
    path = asset(tmp_path)
    before = read_references(path)
    result = import_rows(path, ["frame,jawOpen", f"{before.frames[3]},0.5"], keep_proposed=True)
    after = read_references(path)
    assert after.tuned[3]
    np.testing.assert_array_equal(after.weights[:, 1:], before.weights[:, 1:])
    assert "keep their proposals, which count as tuned (largest: " in noted(result, "not in the")


def test_the_author_is_kept_with_the_pairs_of_an_import(tmp_path: Path) -> None:
    path = asset(tmp_path)
    frames = read_references(path).frames.tolist()
    import_rows(path, keys_at(frames[:4]), author="anna")
    import_rows(path, keys_at(frames[3:6]), author="ben")
    import_rows(path, keys_at(frames[6:7]))
    assert read_references(path).authors == (*["anna"] * 3, *["ben"] * 3, *[""] * 6)


def test_tuned_pairs_of_other_references_are_imported_by_take_and_frame(tmp_path: Path) -> None:
    """Of a rig with other shapes, a selection has other frames at its time codes."""
    path = asset(tmp_path)
    frames = read_references(path).frames
    import_rows(path, keys_at(frames[:3].tolist()))
    (tmp_path / "new").mkdir()
    old = small_references(tmp_path / "new", pairs=PAIRS, seed=1)
    new = write(tmp_path / "new", replace(old, frames=13 * old.frames[::-1], rate=120.0))
    given = ReferencesImportSpec(references=new, weights=path)
    result = execute(given, overwrite=True)
    assert result.figures["pairs"] == 3
    after = read_references(new)
    assert sorted(after.frames[after.tuned].tolist()) == sorted(frames[:3].tolist())
    with pytest.raises(InputError, match="by take and frame; tune some, and leave --at out"):
        execute(given.model_copy(update={"at": "pairs"}), overwrite=True)
