"""Files that a file was made from, found again where they were."""

import json
from pathlib import Path

from usdface.core.provenance import Provenance


def spec_of(provenance: Provenance) -> dict[str, object]:
    """Return the spec that a file was made by; empty where it cannot be read."""
    try:
        said = json.loads(provenance.spec or "{}")
    except ValueError:
        return {}
    return said if isinstance(said, dict) else {}


def path_made_from(file: Path, provenance: Provenance | None, field: str) -> Path | None:
    """Return the file that a field of a file's spec named; None if unsaid, or no longer there.

    Parameters
    ----------
    file : Path
        What was made; paths in its provenance are relative to its folder.
    provenance : Provenance or None
    field : str
    """
    named = spec_of(provenance).get(field) if provenance is not None else None
    if not isinstance(named, str) or not named:
        return None
    path = file.parent / named
    return path if path.is_file() else None
