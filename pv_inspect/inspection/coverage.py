"""Which cells no frame shows as a whole: frames that cut the module may leave some out together."""

from __future__ import annotations

import numpy as np

from pv_inspect.registration.registration import Registration

__all__ = ["unseen_sentence"]

RIM = 0.06
"""Cells. A module that fills its frames to the edge is missing up to some hundredths there."""
SAMPLES = 10
"""Along the side of a cell: each must be seen, for a corner may be all that is missing."""
NAMED = 3


def unseen_sentence(registration: Registration, shape: tuple[int, int]) -> str:
    """Name the cells that are in no frame in use, or not as a whole; "" if there are none.

    Parameters
    ----------
    registration : Registration
    shape : tuple of int
        (height, width) of a frame.
    """
    layout = registration.layout
    at = np.linspace(RIM - 0.5, 0.5 - RIM, SAMPLES)
    x, y = (a.ravel() for a in np.meshgrid(at, at))
    width, height = (a.ravel()[:, None] for a in np.meshgrid(layout.widths, layout.heights))
    points = layout.cell_centres()[:, None] + np.stack([x * width, y * height], axis=-1)
    end = np.array([shape[1], shape[0]]) - 1.0
    seen = np.zeros(points.shape[:2], bool)
    for i in np.flatnonzero(registration.used):
        px = registration.camera.project(registration.homographies[i], points.reshape(-1, 2))
        inside = np.isfinite(px) & (px >= 0) & (px <= end)
        seen |= inside.all(axis=1).reshape(seen.shape)
    missing = np.flatnonzero(~seen.all(axis=1))
    if not missing.size:
        return ""
    named = ", ".join(
        f"row {k // layout.cols + 1}, column {k % layout.cols + 1}" for k in missing[:NAMED]
    )
    more = f" and {missing.size - NAMED} more" if missing.size > NAMED else ""
    cells = "1 cell is" if missing.size == 1 else f"{missing.size} cells are"
    return (
        f"{cells} in no frame that is used, or not as a whole ({named}{more}): what the image "
        "shows there is made up."
    )
