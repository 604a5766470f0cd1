"""How long a run still takes, judged by how long it took so far."""

from __future__ import annotations

__all__ = ["remaining_s", "remaining_text"]

MIN_FRACTION = 0.04
MIN_ELAPSED_S = 2.0
"""Before that an estimate would only jump about."""


def remaining_s(fraction: float, elapsed_s: float) -> float | None:
    """Estimate the seconds that are left.

    Parameters
    ----------
    fraction : float
        Share of the run that is done, 0 to 1.
    elapsed_s : float
        Since its start.

    Returns
    -------
    float or None
        None while too little is done to tell.
    """
    if fraction < MIN_FRACTION or elapsed_s < MIN_ELAPSED_S:
        return None
    return max(0.0, elapsed_s * (1.0 - fraction) / fraction)


def remaining_text(fraction: float, elapsed_s: float) -> str:
    """Return what is left in words, coarse as the estimate is; "" while there is none."""
    left = remaining_s(fraction, elapsed_s)
    if left is None or fraction >= 1.0:
        return ""
    if left < 5:
        return "a few seconds left"
    if left < 55:
        return f"about {5 * round(left / 5)} s left"
    if left < 3600:
        return f"about {round(left / 60)} min left"
    return f"about {left / 3600:.1f} h left"
