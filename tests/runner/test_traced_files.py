"""Files that a step finds by provenance count for what is out of date, as those it names do."""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from tests.steps.small_shot import Shot
from usdface.core.errors import InputError
from usdface.core.provenance import Provenance
from usdface.media.picture.image import write_image
from usdface.runner.execute import execute
from usdface.runner.origin import input_files, make_provenance, provenance_of, traced_files
from usdface.runner.state import step_state
from usdface.specs.capture import CleanSpec, TrackSpec
from usdface.specs.review import ReportSpec, SheetSpec
from usdface.usdio.layers import new_layer


def sheet(shot: Shot, **options: object) -> SheetSpec:
    return SheetSpec(
        performance=shot / "shot.hero.usda",
        out=shot / "found.jpg",
        rows=1,
        tile=64,
        quality="draft",
        **options,
    )


@pytest.mark.slow
def test_a_sheet_is_out_of_date_once_the_take_that_it_found_has_changed(shot: Shot) -> None:
    spec = sheet(shot)
    execute(spec)
    made = provenance_of(spec.out)
    assert made is not None
    assert "shot.clean.take.usda" in made.inputs
    assert execute(spec).up_to_date
    take = shot / "shot.clean.take.usda"
    execute(CleanSpec(take=shot / "shot.take.usda", out=take, smooth=False), overwrite=True)
    assert not execute(spec).up_to_date
    assert execute(spec).up_to_date


def test_files_of_a_performance_are_followed_and_those_that_are_named_are_not(shot: Shot) -> None:
    found = {path.name for path in traced_files(sheet(shot))}
    assert found == {"shot.clean.take.usda", "hero.mapping.usdc", "hero.references.usda"}
    named = sheet(shot, take=shot / "shot.clean.take.usda")
    assert {path.name for path in traced_files(named)} == found - {"shot.clean.take.usda"}
    report = ReportSpec(
        performance=shot / "shot.hero.usda",
        out=shot / "a.html",
        references=shot / "hero.references.usda",
    )
    assert {path.name for path in traced_files(report)} == found - {"hero.references.usda"}
    (shot / "hero.mapping.usdc").unlink()
    assert {path.name for path in traced_files(sheet(shot))} == {"shot.clean.take.usda"}


def test_files_are_found_in_one_order_whatever_the_hashes_of_names(
    shot: Shot, monkeypatch: pytest.MonkeyPatch
) -> None:
    code = (
        "from pathlib import Path; from usdface.runner.origin import traced_files; "
        "from usdface.specs.review import SheetSpec; "
        "spec = SheetSpec(performance=Path('shot.hero.usda'), out=Path('a.jpg')); "
        "print(*traced_files(spec))"
    )
    of_another_seed = subprocess.run(
        [sys.executable, "-c", code],
        cwd=shot / ".",
        env=os.environ | {"PYTHONHASHSEED": "1"},
        capture_output=True,
        check=True,
        text=True,
    ).stdout
    monkeypatch.chdir(shot / ".")
    here = traced_files(SheetSpec(performance=Path("shot.hero.usda"), out=Path("a.jpg")))
    assert " ".join(map(str, here)) == of_another_seed.strip()


def test_a_package_in_capital_letters_has_provenance(tmp_path: Path) -> None:
    made = Provenance(step="package", spec="{}")
    for name in ("a.usda", "A.USDA"):
        with new_layer(tmp_path / name, made):
            pass
        assert provenance_of(tmp_path / name) == made


def test_every_picture_of_a_sequence_counts_as_an_input(tmp_path: Path) -> None:
    first, second = tmp_path / "shot.7.png", tmp_path / "shot.8.png"
    spec = TrackSpec(video=first, video_rate=24, out=tmp_path / "a.take.usda")
    digests = set[str]()
    for shade in (0, 1):
        write_image(first, np.zeros((8, 8, 3), np.uint8))
        digests.add(make_provenance(spec).digest)
        write_image(second, np.full((8, 8, 3), shade, np.uint8))
        digests.add(make_provenance(spec).digest)
    assert len(digests) == 3  # of one picture, of two, and of two of which one has changed
    sheet_alone = ReportSpec(performance=first, sheet=second, out=tmp_path / "a.html")
    assert input_files(second, sheet_alone.reads()[second]) == [second]


def test_a_file_that_was_found_is_never_written_over(shot: Shot) -> None:
    spec = sheet(shot).model_copy(update={"out": shot / "shot.clean.take.usda"})
    before = (shot / "shot.clean.take.usda").read_bytes()
    with pytest.raises(InputError, match="is an input of sheet, and would be overwritten"):
        execute(spec, overwrite=True)
    assert (shot / "shot.clean.take.usda").read_bytes() == before


def test_provenance_that_names_itself_ends(shot: Shot) -> None:
    take = shot / "shot.clean.take.usda"
    mapping = shot / "shot.hero.weights.usdc"  # says that it is mapped, by hero.mapping.usdc
    mapping.replace(shot / "hero.mapping.usdc")
    spec = SheetSpec(performance=shot / "hero.mapping.usdc", out=shot / "a.jpg")
    assert {path.name for path in traced_files(spec)} == {take.name, "hero.mapping.usdc"}


def test_new_samples_below_an_old_layer_are_not_up_to_date(shot: Shot) -> None:
    spec = CleanSpec(take=shot / "shot.take.usda", out=shot / "shot.clean.take.usda")
    assert execute(spec).up_to_date
    old = spec.out.read_bytes()
    execute(spec.model_copy(update={"smooth": False}), overwrite=True)
    spec.out.write_bytes(old)  # as a kill between two renames leaves it
    state = step_state(spec, make_provenance(spec))
    assert state.state == "stale"
    assert "shot.clean.take.samples.usdc is of another, interrupted run" in state.reason
