"""The tuning page: a local server by which an animator sets the weights of reference pairs."""
