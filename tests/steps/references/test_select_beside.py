"""What a selection leaves beside the asset and must not touch: coverage, pictures, tuning."""

import shutil
from collections.abc import Iterator
from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pxr import Usd
from scipy.spatial.transform import Rotation

from tests.steps.references.test_select import spec
from tests.steps.small_shot import PAIRS, Shot
from usdface.core.assets import Video
from usdface.core.errors import InputError
from usdface.core.locks import TuningLock
from usdface.core.provenance import Provenance
from usdface.core.sidecars import lock_path
from usdface.core.text import pluralize
from usdface.media.picture.image import read_image_metadata, read_picture, write_image
from usdface.runner.execute import execute
from usdface.runner.result import StepResult
from usdface.specs.references import (
    ReferencesAddSpec,
    ReferencesCoverageSpec,
    ReferenceSheetSpec,
    ReferencesImportSpec,
)
from usdface.steps.references import select
from usdface.steps.references.images import remove_unused_images
from usdface.tuning.journal import Change
from usdface.tuning.session import TuningSession
from usdface.usdio.references.read import read_pair_notes, read_references
from usdface.usdio.take.read import read_take
from usdface.usdio.take.write import write_take


@pytest.fixture(scope="module", autouse=True)
def _placement_not_drawn() -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(select, "draw_placement", lambda *_, **__: np.zeros((8, 8, 3), np.uint8))
        yield


def copied(shot: Shot, folder: Path) -> Shot:
    own = folder / "Schuss 1 ü"  # a name as users give them
    shutil.copytree(shot.folder, own)
    return replace(shot, folder=own)


@pytest.fixture(scope="module")
def selection(
    finished_shot: Shot, tmp_path_factory: pytest.TempPathFactory
) -> tuple[Shot, dict[str, Any]]:
    """A shot with new references beside its own, which tests do not change, and their figures."""
    shot = copied(finished_shot, tmp_path_factory.mktemp("selection"))
    return shot, execute(spec(shot)).figures


@pytest.fixture
def selected(selection: tuple[Shot, dict[str, Any]], tmp_path: Path) -> Shot:
    return copied(selection[0], tmp_path)


@pytest.fixture(scope="module")
def proposal(finished_shot: Shot, tmp_path_factory: pytest.TempPathFactory) -> Shot:
    """A shot whose references are proposed again, and not tuned; tests do not change it."""
    shot = copied(finished_shot, tmp_path_factory.mktemp("proposal"))
    (shot / "hero.references.tuned.usda").unlink()
    execute(spec(shot, out=shot / "hero.references.usda", count=PAIRS), overwrite=True)
    return shot


@pytest.fixture
def proposed(proposal: Shot, tmp_path: Path) -> Shot:
    return copied(proposal, tmp_path)


def coverage_spec(shot: Shot, take: str, **changed: object) -> ReferencesCoverageSpec:
    given: dict[str, object] = {
        "references": shot / "hero.references.usda",
        "takes": (shot / take,),
        "out": shot / "covered.png",
    }
    return ReferencesCoverageSpec(**(given | changed))  # type: ignore[arg-type]


def test_coverage_as_a_command_is_what_select_said(
    selection: tuple[Shot, dict[str, Any]], selected: Shot
) -> None:
    shot, said = selected, selection[1]
    told = execute(
        coverage_spec(shot, "shot.clean.take.usda", references=shot / "new.references.usda")
    )
    for name in ("coverage", "coverage_by_region", "uncovered_share", "growth", "next"):
        assert told.figures[name] == said[name]
    assert told.figures["of_other_takes"] == 0
    assert f"frame {said['next'][0]['frame']} of shot, mean coverage would" in told.notes[0]
    assert read_image_metadata(shot / "covered.png")["step"] == "references-coverage"


def import_keys(shot: Shot) -> tuple[str, ...]:
    given = {"references": shot / "hero.references.usda", "weights": shot / "keys.csv"}
    return execute(ReferencesImportSpec(**given), overwrite=True).notes


def test_an_import_draws_the_coverage_beside_the_references_as_tuned_as_it_is(
    proposed: Shot,
) -> None:
    shot = proposed
    picture = shot / "hero.references.coverage.png"
    now = shot / "now.png"
    coverage = coverage_spec(shot, "shot.clean.take.usda", out=now)
    before = read_picture(picture)
    assert not import_keys(shot)
    shown = read_picture(picture)
    assert (shown != before).any(), "the count of tuned pairs at least"
    execute(coverage)
    np.testing.assert_array_equal(shown, read_picture(now))
    # It stays what `select` made: neither of the two steps makes the other stale.
    assert read_image_metadata(picture)["step"] == "select"


def test_an_import_leaves_other_pictures_and_says_why_one_is_old(proposed: Shot) -> None:
    shot = proposed
    picture = shot / "hero.references.coverage.png"
    (shot / "shot.clean.take.usda").rename(shot / "moved.take.usda")
    drawn = picture.read_bytes()
    (note,) = [each for each in import_keys(shot) if "coverage" in each]
    assert note.startswith("hero.references.coverage.png was not drawn again, and is out of date: ")
    assert "shot.clean.take.usda" in note
    assert picture.read_bytes() == drawn
    (shot / "moved.take.usda").rename(shot / "shot.clean.take.usda")
    write_image(picture, np.zeros((8, 8, 3), np.uint8))
    import_keys(shot)
    assert read_picture(picture).shape == (8, 8, 3), "somebody's own"
    picture.unlink()
    import_keys(shot)
    assert not picture.exists()


def test_pairs_that_are_added_are_in_the_coverage_beside_the_references(proposed: Shot) -> None:
    shot = proposed
    references, picture = shot / "hero.references.usda", shot / "hero.references.coverage.png"
    before = read_picture(picture)
    hero = shot / "shot.hero.usda"
    given = {"performance": hero, "references": references, "out": references}
    added = execute(ReferencesAddSpec(**given, frames="101,202"), overwrite=True)
    assert picture in added.outputs
    shown = read_picture(picture)
    assert (shown != before).any()
    execute(coverage_spec(shot, "shot.clean.take.usda", out=shot / "now.png"))
    np.testing.assert_array_equal(shown, read_picture(shot / "now.png"))
    assert read_image_metadata(picture)["step"] == "select"
    import_keys(shot)  # the references no longer say what they were selected from: the picture does
    assert (read_picture(picture) != shown).any()
    other = execute(
        ReferencesAddSpec(**given | {"out": shot / "other.references.usda"}, frames="150")
    )
    assert not [path for path in other.outputs if path.suffix == ".png"], "there was none"


def test_pairs_cover_another_take_wherever_its_head_stands(shot: Shot) -> None:
    own = execute(coverage_spec(shot, "shot.clean.take.usda")).figures
    take = read_take(shot / "shot.clean.take.usda")
    assert take.markers is not None
    turn = Rotation.from_rotvec([0.1, -0.2, 0.05]).as_matrix().astype(np.float32)
    moved = replace(take.markers, positions=take.markers.positions @ turn.T + np.float32(30.0))
    write_take(
        shot / "other.take.usda",
        replace(take, name="other", markers=moved),
        provenance=Provenance(),
    )
    told = execute(coverage_spec(shot, "other.take.usda"), overwrite=True)
    assert told.figures["of_other_takes"] == PAIRS
    assert told.notes[0].startswith(f"{PAIRS} of {PAIRS} pairs are of other takes")
    # Markers are stored in single precision and the head is found again: all but exact.
    assert told.figures["coverage"] == pytest.approx(own["coverage"], abs=0.01)


def test_only_tuned_pairs_may_count_and_strange_markers_are_refused(selected: Shot) -> None:
    shot = selected
    few = execute(
        coverage_spec(shot, "shot.clean.take.usda", tuned_only=True), overwrite=True
    ).figures
    assert few["pairs"] == list(range(1, PAIRS + 1))
    with pytest.raises(InputError, match="none of its 12 pairs is tuned"):
        execute(
            coverage_spec(
                shot,
                "shot.clean.take.usda",
                references=shot / "new.references.usda",
                tuned_only=True,
            ),
            overwrite=True,
        )
    take = read_take(shot / "shot.clean.take.usda")
    assert take.markers is not None
    names = tuple(f"x_{name}" for name in take.markers.names)
    rigid = tuple(f"x_{name}" for name in take.markers.rigid)
    strange = replace(take.markers, names=names, rigid=rigid)
    write_take(
        shot / "strange.take.usda",
        replace(take, name="strange", markers=strange),
        provenance=Provenance(),
    )
    with pytest.raises(InputError, match=r"has 0 of the takes' \d+ markers"):
        execute(coverage_spec(shot, "strange.take.usda"), overwrite=True)


RATE = 6


@pytest.fixture(scope="module")
def filmed_selection(
    finished_shot: Shot, tmp_path_factory: pytest.TempPathFactory
) -> tuple[Shot, StepResult]:
    """A shot selected from a take with a camera's pictures: number n is of brightness 8 n."""
    shot = copied(finished_shot, tmp_path_factory.mktemp("filmed"))
    (shot / "plate").mkdir()
    for number in range(4 * RATE):
        plate = np.full((16, 16, 3), 8 * number, np.uint8)
        write_image(shot / "plate" / f"plate.{number:04d}.png", plate)
    video = Video(file=shot / "plate" / "plate.0000.png", rate=Fraction(RATE), offset=0.5)
    take = replace(read_take(shot / "shot.clean.take.usda"), video=video)
    write_take(shot / "filmed.take.usda", take, provenance=Provenance())
    return shot, execute(spec(shot, takes=(shot / "filmed.take.usda",)))


@pytest.mark.usefixtures("coverage_not_drawn")
def test_the_video_frame_of_each_pair_lies_beside_the_references(
    filmed_selection: tuple[Shot, StepResult], tmp_path: Path
) -> None:
    shot, report = copied(filmed_selection[0], tmp_path), filmed_selection[1]
    out, take = shot / "new.references.usda", shot / "filmed.take.usda"
    references = read_references(out)
    notes = read_pair_notes(out)
    stage = Usd.Stage.Open(str(out))
    attribute = stage.GetPrimAtPath("/References").GetAttribute("face:reference:image")
    for pair, (frame, note) in enumerate(zip(references.frames.tolist(), notes, strict=True), 1):
        seconds = (frame - 1) / 120 - 0.5
        named = attribute.Get(pair).path
        if seconds < 0:
            assert not named
            assert note.image is None
            continue
        assert named == f"./new.references.images/shot.{frame}.jpg"
        assert note.image is not None
        shown = read_picture(note.image).mean()
        assert shown == pytest.approx(8 * int(seconds * RATE + 1e-6), abs=1.5)
    before = sum(frame < 61 for frame in references.frames.tolist())
    assert report.figures["images"] == 12 - before
    told = [note for note in report.notes if "does not show" in note]
    assert told == ([f"the video of shot does not show {before} of 12 pairs"] if before else [])
    # A folder that moves takes its pictures along; a new selection leaves none behind.
    execute(spec(shot, takes=(take,), count=6, frames="200-400"), overwrite=True)
    kept = {path.name for path in (shot / "new.references.images").iterdir()}
    assert kept == {f"shot.{frame}.jpg" for frame in read_references(out).frames.tolist()}
    # A picture that somebody else made is neither replaced nor removed.
    plate = shot / "new.references.images" / sorted(kept)[0]
    write_image(plate, np.full((8, 8, 3), 7, np.uint8))
    content = plate.read_bytes()
    report = execute(spec(shot, takes=(take,), count=6, frames="200-400"), overwrite=True)
    assert plate.read_bytes() == content
    assert any(plate.name in note and "not written by select" in note for note in report.notes)
    plate.unlink()
    # What is not ours stays: somebody's picture, even one that is named like a pair's.
    theirs = {shot / "new.references.images" / name for name in ("face.jpg", "plate.0007.jpg")}
    for path in theirs:
        write_image(path, np.zeros((8, 8, 3), np.uint8))
    execute(spec(shot, takes=(take,), count=6, images=False), overwrite=True)
    assert set((shot / "new.references.images").iterdir()) == theirs
    for path in theirs:
        path.unlink()
    remove_unused_images(out, ())
    assert not (shot / "new.references.images").exists()


@pytest.mark.usefixtures("coverage_not_drawn")
def test_a_video_that_is_gone_costs_its_pictures_and_nothing_else(
    filmed_selection: tuple[Shot, StepResult], tmp_path: Path
) -> None:
    shot = copied(filmed_selection[0], tmp_path)
    take = shot / "filmed.take.usda"
    folder = shot / "new.references.images"
    pictures = {path.name: path.read_bytes() for path in folder.iterdir()}
    for path in (shot / "plate").iterdir():
        path.unlink()
    sheet = execute(
        ReferenceSheetSpec(
            references=shot / "new.references.usda",
            out=shot / "kept.png",
            tile=64,
            quality="draft",
        )
    )
    pairs_without = sum(n.image is None for n in read_pair_notes(shot / "new.references.usda"))
    said = f"no video frame for {pluralize(pairs_without, 'pair')}"
    assert any(said in note for note in sheet.notes) == bool(pairs_without)
    report = execute(spec(shot, takes=(take,)), overwrite=True)
    # No picture of a pair can be made again, so each is kept and still referred to.
    assert any("pairs of shot keep their earlier pictures, as" in note for note in report.notes)
    assert {path.name: path.read_bytes() for path in folder.iterdir()} == pictures
    named = {note.image for note in read_pair_notes(shot / "new.references.usda")}
    assert named - {None} == set(folder.iterdir())
    assert report.figures["images"] == len(pictures)
    execute(spec(shot, takes=(take,), count=6), overwrite=True)
    after = read_references(shot / "new.references.usda")
    shown = {f"shot.{frame}.jpg" for frame in after.frames.tolist()}
    assert {path.name for path in folder.iterdir()} == shown & pictures.keys()
    report = execute(spec(shot, takes=(take,), out=shot / "other.references.usda"))
    assert any("the pairs of shot have no pictures: " in note for note in report.notes)
    assert report.figures["images"] == 0


def asset_bytes(out: Path) -> dict[str, bytes]:
    beside = out.parent.glob(f"{out.name.split('.')[0]}.references*")
    return {path.name: path.read_bytes() for path in beside}


def test_placement_and_pairs_are_those_of_one_run(
    selected: Shot, monkeypatch: pytest.MonkeyPatch
) -> None:
    shot = selected
    out = shot / "new.references.usda"
    before = asset_bytes(out)
    assert any(name.endswith(".placement.usda") for name in before)

    def stopped(*args: object, **options: object) -> None:
        raise InputError("the disk is full")

    monkeypatch.setattr(select, "write_references", stopped)
    with pytest.raises(InputError, match="the disk is full"):
        execute(spec(shot, count=PAIRS - 1), overwrite=True)
    assert asset_bytes(out) == before


def test_nothing_is_selected_under_the_hand_that_tunes(shot: Shot) -> None:
    out = shot / "hero.references.usda"
    before = asset_bytes(out)
    lock = TuningLock(lock_path(out))
    lock.acquire()
    with pytest.raises(InputError, match=r"has been tuning it since .* under their hand"):
        execute(spec(shot, out=out, count=PAIRS + 1), overwrite=True)
    lock.release()
    assert asset_bytes(out) == before
    execute(spec(shot, out=out, count=PAIRS + 1), overwrite=True)
    assert not lock_path(out).exists()


def test_changes_of_a_page_that_was_killed_are_taken_in_before_pairs_move(shot: Shot) -> None:
    out = shot / "hero.references.usda"
    before = read_references(out)
    session = TuningSession(out)
    first = Change(0, before.takes[0], int(before.frames[0]), {before.shape_names[0]: 0.123})
    session.apply([first], revision=session.revision)
    session.lock.release()  # what the operating system does for a killed page: nothing was saved
    with pytest.raises(InputError, match=r"holds changes of a tuning page that was killed"):
        execute(spec(shot, out=out, count=PAIRS + 1), overwrite=True)
    TuningSession(out).close()
    execute(spec(shot, out=out, count=PAIRS + 1), overwrite=True)
    assert read_references(out).weights[0, 0] == pytest.approx(0.123)


def test_pairs_tuned_while_frames_are_chosen_are_not_moved(
    selected: Shot, monkeypatch: pytest.MonkeyPatch
) -> None:
    shot = selected
    new = shot / "new.references.usda"
    kept = read_references(new)
    chosen = select.rank_by_information

    def tuned_meanwhile(*given: object) -> object:
        execute(ReferencesImportSpec(references=new, weights=shot / "keys.csv"), overwrite=True)
        return chosen(*given)  # type: ignore[arg-type]

    monkeypatch.setattr(select, "rank_by_information", tuned_meanwhile)
    with pytest.raises(InputError, match="12 pairs tuned while frames were chosen"):
        execute(spec(shot, count=20), overwrite=True)
    after = read_references(new)
    np.testing.assert_array_equal(after.frames, kept.frames)
    assert after.tuned.all()
