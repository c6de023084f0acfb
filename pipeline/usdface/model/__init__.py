"""Trained mappings: fit one from references, predict with one, choose between several."""
