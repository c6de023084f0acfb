"""Positions of a performer's markers on a rig's face, and checks of both."""
