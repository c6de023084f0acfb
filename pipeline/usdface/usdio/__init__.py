"""Reading and writing of assets as USD layers; the only importer of pxr.

Our codeless schemas are registered here, before USD's schema registry is first used.
"""

import os

from usdface.core.errors import UsdfaceError
from usdface.core.plugin_path import plugin_folders, register_plugin_path

SCHEMA_VERSION = 1
"""Incremented when the meaning of an attribute changes; layers with newer ones are refused."""


def register_schemas() -> None:
    """Register schemas and validators with USD, in this process and its children."""
    register_plugin_path()
    folders = list(map(str, plugin_folders()))

    from pxr import Plug, Usd

    Plug.Registry().RegisterPlugins(folders)
    # A schema registry that already exists (in a DCC) ignores plug-ins registered later.
    if Usd.SchemaRegistry().FindAppliedAPIPrimDefinition("FaceTakeAPI") is None:
        raise UsdfaceError(
            "USD was in use before usdface was imported, so its schemas are not known; import "
            f"usdface first, or set PXR_PLUGINPATH_NAME={os.pathsep.join(folders)} before starting"
        )


register_schemas()
