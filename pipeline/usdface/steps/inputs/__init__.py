"""Inputs shared by several workflows."""
