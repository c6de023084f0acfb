"""Performances and their edits."""
