"""A references asset small enough to make for every test: five pairs over the small rig."""

from pathlib import Path

import numpy as np

from tests.usdio.small_rig import small_rig
from usdface.core.assets import References
from usdface.core.provenance import Provenance
from usdface.tuning.journal import Change
from usdface.tuning.session import TuningSession
from usdface.usdio.references.write import write_references
from usdface.usdio.rig.read import read_rig
from usdface.usdio.rig.write import write_rig

PAIRS = 5


def small_references(folder: Path, *, take: str = "kitchen", first: int = 100) -> References:
    rng = np.random.default_rng(0)
    return References(
        marker_names=("a", "b", "c", "d"),
        shape_names=("jawOpen", "eyeBlink", "smile"),
        markers=rng.normal(0, 50, (PAIRS, 4, 3)),
        weights=rng.random((PAIRS, 3)).astype(np.float32).astype(np.float64),
        frames=np.arange(PAIRS) * 7 + first,
        takes=(take,) * PAIRS,
        tuned=np.zeros(PAIRS, dtype=np.bool_),
        rigid=("a", "b", "c"),
        neutral=rng.normal(0, 50, (4, 3)),
        rig_file=folder / "rig.usda",
        rig_prim="/Hero",
    )


def write_asset(
    folder: Path, references: References | None = None, *, provenance: Provenance | None = None
) -> Path:
    """Write the asset, or select it anew: what is tuned stays."""
    if not (folder / "rig.usda").exists():
        write_rig(folder / "rig.usda", small_rig())
    path = folder / "hero.references.usda"
    write_references(
        path,
        references or small_references(folder),
        read_rig(folder / "rig.usda"),
        provenance=provenance or Provenance(),
    )
    return path


def change(session: TuningSession, pair: int, **weights: float) -> Change:
    references = session.references
    return Change(pair, references.takes[pair], int(references.frames[pair]), weights)


def put(session: TuningSession, pair: int, **weights: float) -> None:
    session.apply([change(session, pair, **weights)], revision=session.revision)
