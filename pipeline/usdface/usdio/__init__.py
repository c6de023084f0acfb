"""The only importer of pxr: assets to and from USD layers."""
