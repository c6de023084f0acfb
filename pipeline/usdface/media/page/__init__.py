"""Web pages and their data."""
