"""What follows the hand: the grid, one cell, the curve over kappa."""
