"""Regression over a surface: multiquadrics and Gaussian processes under any distance."""
