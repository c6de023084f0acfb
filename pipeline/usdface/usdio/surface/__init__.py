"""Bindings, point caches and generated rigs."""
