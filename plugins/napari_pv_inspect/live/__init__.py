"""Views that follow the controls while they move: the grid, one cell, the curve over kappa."""
