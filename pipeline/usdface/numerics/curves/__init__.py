"""Weights as curves that animators edit: changes on top of a solve, and fewer keys."""
