"""AYON: what AYON finds where this folder is an add-on's client folder."""

from .usdface_addon import UsdfaceAddon

__all__ = ["UsdfaceAddon"]
