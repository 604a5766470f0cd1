"""Drizzle: variable-pixel linear reconstruction, by the package of that name.

References
----------
.. [1] A. S. Fruchter, R. N. Hook, "Drizzle: A Method for the Linear Reconstruction of Undersampled
       Images", PASP 114, 2002. doi:10.1086/338393
"""

from __future__ import annotations

from collections.abc import Generator

import numpy as np
from numpy.typing import NDArray

from pv_inspect.common.work import Progress
from pv_inspect.errors import InspectionError
from pv_inspect.evaluation.case import Case

__all__ = ["drizzled"]

Image = NDArray[np.float32]

# Side of the drop over that of a pixel; half and less leave holes with 20 frames at 4x.
_PIXFRAC = 0.8


def drizzled(case: Case) -> Generator[Progress, None, Image]:
    """Drop the pixels of all frames onto the grid of a case.

    Parameters
    ----------
    case : Case

    Yields
    ------
    Progress

    Returns
    -------
    (H, W) float32
        Module's intensity scale; 0 where nothing fell.

    Raises
    ------
    InspectionError
        If the package is not installed.
    """
    try:
        from drizzle.resample import Drizzle
    except ImportError:
        raise InspectionError(
            "DRIZZLE needs the package drizzle, which is not installed: "
            "pip install 'pv-inspect[peers]'."
        ) from None
    registration, grid = case.registration, case.grid
    height, width = case.sequence.shape
    y, x = np.mgrid[:height, :width].astype(np.float64)
    px = np.stack([x, y], axis=-1)
    made = Drizzle(kernel="square", fillval="0", out_shape=grid.shape, disable_ctx=True)
    used = np.flatnonzero(registration.used)
    for k, i in enumerate(used, start=1):
        frame = case.sequence.frame(int(i))
        image = (frame.image - registration.offset[i]) / registration.gain[i]
        at = grid.to_pixels(registration.camera.unproject(registration.homographies[i], px))
        seen = frame.valid & np.isfinite(at).all(axis=-1)
        made.add_image(
            np.where(seen, image, 0).astype(np.float32),
            exptime=1.0,
            pixmap=at,  # NaN beyond the fold of the lens: skipped
            weight_map=seen.astype(np.float32),
            pixfrac=_PIXFRAC,
            in_units="cps",
        )
        yield Progress(k / used.size, f"drizzling frame {k} of {used.size}")
    return np.nan_to_num(np.asarray(made.out_img, np.float32))
