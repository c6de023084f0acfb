"""Registration of our USD schemas and validators, which must precede the import of USD."""

import os
from pathlib import Path

from usdface.core.errors import UsdfaceError

PACKAGE = Path(__file__).resolve().parents[1]


def schema_folder() -> Path:
    """Return the folder of plugInfo.json: inside a wheel, or at the root of a checkout."""
    candidates = (PACKAGE / "schemas" / "usdface", PACKAGE.parents[1] / "schemas" / "usdface")
    for folder in candidates:
        if (folder / "plugInfo.json").is_file():
            return folder
    raise UsdfaceError(
        f"usdface is installed without its USD schemas: no plugInfo.json in "
        f"{' or '.join(map(str, candidates))}; reinstall the package"
    )


def plugin_folders() -> tuple[Path, ...]:
    """Return the folders for PXR_PLUGINPATH_NAME: schemas and validators."""
    return schema_folder(), PACKAGE / "usdio" / "checks"


def register_plugin_path() -> None:
    """Add our folders to PXR_PLUGINPATH_NAME, of this process and its children."""
    known = os.environ.get("PXR_PLUGINPATH_NAME", "").split(os.pathsep)
    new = [folder for folder in map(str, plugin_folders()) if folder not in known]
    os.environ["PXR_PLUGINPATH_NAME"] = os.pathsep.join(filter(None, (*known, *new)))
