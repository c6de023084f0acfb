"""Reading and writing of assets as USD layers; the only importer of pxr."""

from usdface.usdio.plugin import register_schemas

register_schemas()
