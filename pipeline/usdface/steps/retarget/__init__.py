"""From one face to another."""
