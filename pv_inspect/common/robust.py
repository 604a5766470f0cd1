"""Robust statistics: what a median says of a normal distribution."""

from __future__ import annotations

__all__ = ["MAD_TO_SIGMA", "MEDIAN_CHI2"]

MAD_TO_SIGMA = 1.4826
"""Standard deviation over median absolute deviation of a normal distribution."""
MEDIAN_CHI2 = 0.455
"""Median of the square of a standard normal variable (chi-squared, one degree of freedom)."""
