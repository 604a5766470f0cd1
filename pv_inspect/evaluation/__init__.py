"""Comparing reconstruction methods on the same frames, cells and grid (paper, Sec. IV)."""
