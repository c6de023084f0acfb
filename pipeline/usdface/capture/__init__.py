"""Readers of capture formats: a file in, a `usdface.assets.Take` out; one format a file."""
