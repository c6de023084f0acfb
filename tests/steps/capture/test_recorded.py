"""Captures that were really recorded, from file to sheet."""

from pathlib import Path

import numpy as np
import pytest

from usdface.core.assets import Take
from usdface.media.picture.image import read_image_metadata
from usdface.runner.execute import execute
from usdface.specs.capture import CleanSpec, IngestSpec
from usdface.specs.performance import MapSpec, TrainSpec
from usdface.specs.references import SelectSpec
from usdface.specs.review import SheetSpec
from usdface.usdio.take.read import read_take


def spread(take: Take, names: tuple[str, ...]) -> float:
    """How far markers travel over a take [mm]: standard deviation about their mean."""
    columns = [take.markers.names.index(name) for name in names]
    positions = take.markers.positions[:, columns].astype(float)
    return float(np.sqrt(((positions - positions.mean(axis=0)) ** 2).sum(axis=2).mean()))


@pytest.mark.slow
def test_recorded_cheeks_reach_a_sheet_and_the_head_stands_still(shared_data, tmp_path) -> None:
    capture = shared_data / "markers_animface" / "CheeksMoCap.c3d"
    rig = shared_data / "rigs" / "facecap_head.usdc"
    take, clean = tmp_path / "c.take.usda", tmp_path / "c.clean.take.usda"
    references, mapping = tmp_path / "c.references.usda", tmp_path / "c.mapping.usdc"
    performance, sheet = tmp_path / "c.hero.usda", tmp_path / "c.sheet.png"
    execute(IngestSpec(sources=(capture,), out=take))
    report = execute(CleanSpec(take=take, out=clean))
    execute(SelectSpec(takes=(clean,), rig=rig, out=references, count=30))
    execute(TrainSpec(references=references, out=mapping))
    execute(MapSpec(take=clean, mapping=mapping, rig=rig, out=performance))
    execute(
        SheetSpec(performance=performance, take=clean, out=sheet, rows=3, tile=128, quality="draft")
    )
    before, after = read_take(take), read_take(clean)
    rigid = after.markers.rigid
    assert any("no rigid markers were named" in note for note in report.notes)
    assert spread(after, rigid) < 0.5 * spread(before, rigid), "head motion leaves"
    cheeks = tuple(name for name in after.markers.names if "heek" in name)
    assert spread(after, cheeks) > 3 * spread(after, rigid), "cheeks move"
    assert read_image_metadata(sheet)["step"] == "sheet"


def test_every_recorded_c3d_of_other_systems_is_read_or_refused(shared_data: Path) -> None:
    from usdface.capture.sniff import read_capture
    from usdface.core.errors import InputError

    read, refused = [], {}
    for path in sorted((shared_data / "c3d").rglob("*")):
        if path.suffix.lower() != ".c3d":
            continue
        try:
            take = read_capture(path).take
        except InputError as error:
            refused[path.name] = str(error)
        else:
            assert np.isfinite(take.markers.positions).all()
            read.append(path.name)
    assert {"DEC_INT.C3D", "Dec_real.c3d", "pc_real.c3d", "sgi_int.c3d"} <= set(read)
    assert set(refused) <= {"bad_parameter_section.c3d"}
    assert all(name in message for name, message in refused.items())
