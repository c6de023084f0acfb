"""A table of weights by other names than the rig's."""

import numpy as np

from usdface.steps.inputs.weight_tables import WeightTable


def test_driven_shapes_are_left_and_others_matched_by_meaning() -> None:
    names = ("JawOpen", "jaw_smile", "mouth_smile_L", "HeadYaw")
    weights = np.arange(8.0).reshape(2, 4)
    table, transfer = WeightTable(names, (1, 2), weights).by_meaning(
        ("jawOpen", "mouthSmileLeft", "mouthSmileRight"), leave={"jaw_smile"}
    )
    assert table.names == ("jawOpen", "mouthSmileLeft")
    np.testing.assert_array_equal(table.weights, weights[:, [0, 2]])
    assert set(transfer.matched) == {"JawOpen", "mouth_smile_L"}


def test_names_that_mean_nothing_stay_for_the_message() -> None:
    given = WeightTable(("a", "b"), (1,), np.ones((1, 2)))
    table, transfer = given.by_meaning(("jawOpen", "smile"))
    assert table is given
    assert not transfer.matched
