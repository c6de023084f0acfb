"""A table of weights by other names than the rig's."""

from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest

from tests.steps.retarget.test_names import SHAPES, phone_csv
from usdface.core.assets import WeightsClip
from usdface.core.errors import InputError
from usdface.steps.inputs.weight_tables import WeightTable, read_weight_table


def test_driven_shapes_are_left_and_others_matched_by_meaning() -> None:
    names = ("JawOpen", "jaw_smile", "mouth_smile_L", "HeadYaw")
    weights = np.arange(8.0).reshape(2, 4)
    table, transfer = WeightTable(names, (1, 2), weights).by_meaning(
        ("jawOpen", "mouthSmileLeft", "mouthSmileRight"), leave={"jaw_smile"}
    )
    assert table.names == ("jawOpen", "mouthSmileLeft")
    np.testing.assert_array_equal(table.weights, weights[:, [0, 2]])
    assert set(transfer.matched) == {"JawOpen", "mouth_smile_L"}


def test_keys_of_a_recorder_are_read_as_its_takes_are(tmp_path: Path) -> None:
    """Live Link's count of shapes is no shape, and its timecode tells the rate."""
    weights = np.round(np.random.default_rng(0).random((130, len(SHAPES))), 6)
    path = phone_csv(tmp_path / "phone.csv", weights)
    table = read_weight_table(path)
    assert table.names == SHAPES
    assert (table.frames, table.rate) == (tuple(range(1, 131)), 60)
    np.testing.assert_allclose(table.weights, weights, atol=1e-7)
    assert table.notes(path, table.names, owner="on the rig")
    rows = path.read_text(encoding="utf-8").replace(f",{weights[2, 0]:.9g},", ",much,", 1)
    path.write_text(rows, encoding="utf-8")
    with pytest.raises(InputError, match=r"line 4.*'much'"):
        read_weight_table(path)


def test_frames_between_frames_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "keys.csv"
    path.write_text("frame,jawOpen,smile\n1,0,0\n2.5,1,0\n", encoding="utf-8")
    with pytest.raises(InputError, match=r"line 3: frame number 2\.5; it must be a whole number"):
        read_weight_table(path)


def test_keys_of_a_take_are_those_of_its_last_part_wherever_it_starts() -> None:
    weights = np.random.default_rng(0).random((200, 2))
    table = WeightTable(("a", "b"), tuple(range(1, 201)), weights)
    part = WeightsClip(table.names, weights[100:].astype(np.float32), 101, Fraction(60))
    paths = {"file": Path("keys.csv"), "performance": Path("part.usda")}
    table.check_numbering(part, columns=table.names, **paths)
    counted = WeightsClip(table.names, np.repeat(weights, 2, axis=0)[1:], 1, Fraction(60))
    with pytest.raises(InputError, match=r"keys\.csv: its rows match .* count 30 frames"):
        table.check_numbering(counted, columns=table.names, **paths)


def test_names_that_mean_nothing_stay_for_the_message() -> None:
    given = WeightTable(("a", "b"), (1,), np.ones((1, 2)))
    table, transfer = given.by_meaning(("jawOpen", "smile"))
    assert table is given
    assert not transfer.matched
