"""Readers of capture formats, one module each: from a file to a `usdface.core.assets.Take`."""
