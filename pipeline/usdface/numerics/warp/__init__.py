"""Motion put into motion: 1-D Laplacian warping, retiming, and finding where a sequence recurs."""
