"""Run steps and jobs: checks before, provenance after, only what is out of date."""
