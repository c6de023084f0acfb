"""The only importer of pxr: assets to and from USD layers."""

from usdface.usdio.plugin import register_schemas

register_schemas()
