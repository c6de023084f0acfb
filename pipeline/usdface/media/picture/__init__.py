"""Pictures and contact sheets."""
