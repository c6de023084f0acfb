"""The blendshape equation and its kin: weights whose shapes explain what was seen."""
