"""Corrected crack marks on the module image: the expert's in place of the detector's."""

from __future__ import annotations

import numpy as np
from napari.components import ViewerModel
from napari.layers import Image
from napari.utils.colormaps import Colormap
from numpy.typing import NDArray

from napari_pv_inspect import appearance
from napari_pv_inspect.layers.module import ModuleLayers
from napari_pv_inspect.layers.slot import LayerSlot
from napari_pv_inspect.review.model import ReviewModel
from pv_inspect.review import Cell

__all__ = ["CorrectionLayers"]


class CorrectionLayers:
    """Takes corrected cells out of the layer of the detector, and shows them in one of their own.

    The arrays of the inspection stay as they are.
    """

    def __init__(self, viewer: ViewerModel, module: ModuleLayers, review: ReviewModel) -> None:
        self._module, self._review = module, review
        self._marks = LayerSlot(
            viewer,
            Image,
            name=appearance.CORRECTED,
            colormap=Colormap(**appearance.corrected_colormap()),
            contrast_limits=(0.0, 1.0),
            blending="translucent",
            opacity=0.9,
        )
        self._of: NDArray[np.float32] | None = None
        self._detected = np.empty((0, 0), np.float32)
        self._corrected = np.empty((0, 0), np.uint8)
        module.cracks_shown.connect(self._on_cracks)
        review.marks_changed.connect(self._on_marks)

    def _on_cracks(self, cracks: NDArray[np.float32] | None) -> None:
        if cracks is None:
            self._marks.hide_until_put()
            self._of = None
        else:
            self._on_marks(None)

    def _on_marks(self, cell: Cell | None) -> None:
        subject, cracks = self._review.subject, self._module.cracks
        if subject is None or subject.cracks is None or subject.cracks.probability is not cracks:
            self._marks.drop()
            self._of = None
            return
        corrections = self._review.corrections
        if not corrections:
            self._marks.drop()
            if self._of is not None and self._module.has_cracks:
                self._module.put_cracks(cracks)
            self._of = None
            return
        if self._of is not cracks or cell is None:
            self._of, self._detected = cracks, cracks.copy()
            self._corrected = np.zeros(cracks.shape, np.uint8)
            changed = list(corrections)
        else:
            changed = [cell]
        for place in changed:
            where, mask = subject.tiles.grid.cell_slices(*place), corrections.get(place)
            self._detected[where] = cracks[where] if mask is None else 0.0
            self._corrected[where] = 0 if mask is None else mask
        if self._module.has_cracks:
            self._module.put_cracks(self._detected)
        self._show()

    def _show(self) -> None:
        place = self._module.placement
        if place is None:
            return
        layer = self._marks.layer
        if layer is not None and layer.data is self._corrected:
            layer.refresh()
        else:
            self._marks.put(self._corrected, scale=place.scale, translate=place.translate)
