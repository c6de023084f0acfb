"""What every layer shares: arrays, assets, errors, files, time."""
