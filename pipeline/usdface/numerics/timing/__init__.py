"""Delays and clock drift between recordings."""
