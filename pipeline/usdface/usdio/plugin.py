"""Register our codeless schemas before USD's schema registry is first used."""

import os
from pathlib import Path

from usdface.errors import UsdfaceError

SCHEMA_VERSION = 1
"""Raised when the meaning of an attribute changes; layers carry it, newer ones are refused."""


def schema_folder() -> Path:
    """Return the folder of plugInfo.json: inside a wheel, or at the root of a checkout."""
    package = Path(__file__).resolve().parents[1]
    candidates = (package / "schemas" / "usdface", package.parents[1] / "schemas" / "usdface")
    for folder in candidates:
        if (folder / "plugInfo.json").is_file():
            return folder
    raise UsdfaceError(
        f"usdface is installed without its USD schemas: no plugInfo.json in "
        f"{' or '.join(map(str, candidates))}; reinstall the package"
    )


def plugin_folders() -> tuple[Path, ...]:
    """Return what belongs into PXR_PLUGINPATH_NAME: the schemas, and the validators."""
    return schema_folder(), Path(__file__).resolve().parent / "checks"


def register_schemas() -> None:
    """Make schemas and validators known to USD in this process and in those it starts."""
    folders = list(map(str, plugin_folders()))
    known = os.environ.get("PXR_PLUGINPATH_NAME", "").split(os.pathsep)
    new = [folder for folder in folders if folder not in known]
    os.environ["PXR_PLUGINPATH_NAME"] = os.pathsep.join(filter(None, (*known, *new)))

    from pxr import Plug, Usd

    Plug.Registry().RegisterPlugins(folders)
    # A registry built earlier in this process (a DCC) never learns of a plug-in that comes late.
    if Usd.SchemaRegistry().FindAppliedAPIPrimDefinition("FaceTakeAPI") is None:
        raise UsdfaceError(
            "USD was in use before usdface was imported, so its schemas are not known; import "
            f"usdface first, or set PXR_PLUGINPATH_NAME={os.pathsep.join(folders)} before starting"
        )
