"""Names, colours and contrast of what the workbench draws.

The colours are of the set of Okabe and Ito, which stays distinct with a colour-vision deficiency,
and they differ in brightness over grey images too.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

__all__ = [
    "CONSISTENCY",
    "CONSISTENCY_LIMITS",
    "CORRECTED",
    "CORRECTED_RGB",
    "CRACKS",
    "CRACK_RGB",
    "DOUBT_COLOUR",
    "EDITED_COLOUR",
    "FOCUS_ON_DARK",
    "FOCUS_ON_LIGHT",
    "FRAMES",
    "GRID",
    "GRID_COLOUR",
    "MEASURED_COLOUR",
    "MODULE",
    "POINTS",
    "POINT_SIZES",
    "POINT_SYMBOLS",
    "PREDICTED_COLOUR",
    "PRIMARY_COLOUR",
    "PRIMARY_HOVER_COLOUR",
    "SUPPORT",
    "WARNING_COLOUR",
    "contrast_limits",
    "corrected_colormap",
    "crack_colormap",
]

FRAMES = "Frames"
POINTS = "Crossing points"
GRID = "Fitted grid"
MODULE = "Module image"
SUPPORT = "Support"
CONSISTENCY = "Contradictions"
CONSISTENCY_LIMITS = (0.5, 3.0)
"""Residual of the frames, in units of the noise."""
CRACKS = "Cracks"
CORRECTED = "Corrected cracks"

GRID_COLOUR = "#56B4E9"
MEASURED_COLOUR = "#F0E442"
PREDICTED_COLOUR = "#D55E00"
EDITED_COLOUR = "#CC79A7"
POINT_SYMBOLS = ("disc", "x", "diamond")
"""Of measured, predicted and edited crossing points: not by their colours alone."""
POINT_SIZES = (6.0, 7.0, 9.0)
"""LR px."""
CRACK_RGB = (1.0, 0.55, 0.0)
PRIMARY_COLOUR, PRIMARY_HOVER_COLOUR = "#0072B2", "#1A86C4"
"""Of the button for what comes next, behind white letters."""
FOCUS_ON_DARK, FOCUS_ON_LIGHT = "#F0E442", "#1A1A1A"
"""Of the border around what the keyboard acts on."""
CORRECTED_RGB = (0.0, 0.447, 0.698)
"""Of marks that a person has drawn: stands out from grey and from orange with any colour vision."""


WARNING_COLOUR, DOUBT_COLOUR = "#E69F00", "#F0803C"
"""Of words on the dark of napari: worth knowing, and a reason not to rely on a result."""


def crack_colormap() -> dict[str, Any]:
    """From clear through amber to bright orange: the image stays visible where nothing is."""
    r, g, b = CRACK_RGB
    clear, half, full = (r, g, b, 0.0), (r, 0.75, 0.2, 0.55), (r, g, b, 1.0)
    return {
        "name": "crack probability",
        "colors": np.array([clear, clear, half, full], dtype=np.float32),
        "controls": np.array([0.0, 0.15, 0.5, 1.0], dtype=np.float32),
    }


def corrected_colormap() -> dict[str, Any]:
    """Clear, and the colour of what a person has drawn."""
    colours = np.array([(*CORRECTED_RGB, 0.0), (*CORRECTED_RGB, 1.0)], dtype=np.float32)
    return {"name": "corrected cracks", "colors": colours}


def contrast_limits(image: NDArray[Any]) -> tuple[float, float]:
    """Limits without the darkest 0.5 and the brightest 0.2 percent; never an empty range."""
    values = np.asarray(image, dtype=np.float32).ravel()[:: max(1, image.size // 200_000)]
    values = values[np.isfinite(values)]
    if values.size == 0:
        return 0.0, 1.0
    low, high = (float(v) for v in np.percentile(values, (0.5, 99.8)))
    return (low, high) if high > low else (low, low + 1.0)
