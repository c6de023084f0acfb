"""Poses: a head's motion found, removed and smoothed."""
