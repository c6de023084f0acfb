"""A layer whose rate is none is refused at once, not searched without end."""

from pathlib import Path

import pytest
from pxr import Sdf

from usdface.errors import InputError
from usdface.usdio.layers import open_stage


@pytest.mark.parametrize("rate", [0.0, -24.0, float("nan"), float("inf")])
def test_a_sublayer_with_a_rate_that_is_none_is_refused_by_name(
    tmp_path: Path, rate: float
) -> None:
    below = Sdf.Layer.CreateNew(str(tmp_path / "samples.usda"))
    below.timeCodesPerSecond = rate
    below.Save()
    above = Sdf.Layer.CreateNew(str(tmp_path / "take.usda"))
    above.timeCodesPerSecond = 24
    above.subLayerPaths = ["./samples.usda"]
    above.Save()
    with pytest.raises(InputError, match=r"samples\.usda: timeCodesPerSecond is"):
        open_stage(tmp_path / "take.usda")
