"""Facial capture to BlendShape weights, as a stage of an OpenUSD pipeline."""

from usdface.version import __version__

__all__ = ["__version__"]
