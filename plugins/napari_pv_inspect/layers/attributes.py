"""How the layers of the module image look when they are new, from a run or from the reader."""

from __future__ import annotations

from typing import Any

from napari.utils.colormaps import Colormap

from napari_pv_inspect.appearance import (
    CONSISTENCY,
    CONSISTENCY_LIMITS,
    CORRECTED,
    CRACKS,
    MODULE,
    SUPPORT,
    corrected_colormap,
    crack_colormap,
)

__all__ = ["MODULE_PARTS", "attributes_of"]

MODULE_PARTS = (MODULE, SUPPORT, CONSISTENCY, CRACKS)
"""Names of the layers that a result folder holds, from the lowest."""


def attributes_of(name: str) -> dict[str, Any]:
    """Return the attributes of a new image layer; the contrast of the module image is its own."""
    return {"name": name, **_looks()[name]}


def _looks() -> dict[str, dict[str, Any]]:
    return {
        MODULE: {"colormap": "gray"},
        SUPPORT: {"colormap": "viridis", "contrast_limits": (0.0, 1.0), "visible": False},
        CONSISTENCY: {
            "colormap": "magma",
            "contrast_limits": CONSISTENCY_LIMITS,
            "visible": False,
        },
        CRACKS: {
            "colormap": Colormap(**crack_colormap()),
            "contrast_limits": (0.0, 1.0),
            "blending": "translucent",
            "opacity": 0.75,
        },
        CORRECTED: {
            "colormap": Colormap(**corrected_colormap()),
            "contrast_limits": (0.0, 1.0),
            "blending": "translucent",
            "opacity": 0.9,
        },
    }
