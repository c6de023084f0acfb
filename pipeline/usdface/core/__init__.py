"""Common to all layers: array types, assets, errors, files, rates and timecode."""
