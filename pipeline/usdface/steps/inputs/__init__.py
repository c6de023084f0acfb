"""What several workflows read."""
