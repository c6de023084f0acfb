"""Expression pairs, control vectors, retargetings and sequences."""
