"""Retargeting: from the weights of one rig to the controls of another."""
