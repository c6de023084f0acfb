"""References to a mapping, takes to performances."""
