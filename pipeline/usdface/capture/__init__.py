"""Readers of capture formats: a file in, a `usdface.core.assets.Take` out; one format a file."""
