"""AYON: client folder of an add-on."""

from .usdface_addon import UsdfaceAddon

__all__ = ["UsdfaceAddon"]
