"""What the train step gives to training beyond the pairs."""

from pathlib import Path

from tests.steps.small_shot import Shot
from usdface.specs.train import TrainSpec
from usdface.steps.execute import execute
from usdface.usdio.mapping import read_mapping


def test_the_geometry_of_the_rig_takes_part_in_training(
    finished_shot: Shot, tmp_path: Path
) -> None:
    references, out = finished_shot / "hero.references.usda", tmp_path / "x.mapping.usdc"
    execute(TrainSpec(references=references, out=out, method="ensemble"))
    assert read_mapping(out).settings["geometry"] is True
