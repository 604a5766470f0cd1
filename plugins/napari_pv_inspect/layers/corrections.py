"""Corrected crack marks on the module image: the expert's in place of the detector's."""

from __future__ import annotations

import numpy as np
from napari.components import ViewerModel
from napari.layers import Image
from numpy.typing import NDArray

from napari_pv_inspect.appearance import CORRECTED
from napari_pv_inspect.layers.attributes import attributes_of
from napari_pv_inspect.layers.module import ModuleLayers
from napari_pv_inspect.layers.slot import LayerSlot
from napari_pv_inspect.review.data import ALL_MARKS, ReviewChange
from napari_pv_inspect.review.model import ReviewModel
from napari_pv_inspect.review.subject import Subject

__all__ = ["CorrectionLayers"]


class CorrectionLayers:
    """Takes corrected cells out of the layer of the detector, and shows them in one of their own.

    The arrays of the inspection stay as they are.
    """

    def __init__(self, viewer: ViewerModel, module: ModuleLayers, review: ReviewModel) -> None:
        self._module, self._review = module, review
        self._marks = LayerSlot(viewer, Image, **attributes_of(CORRECTED))
        self._of: NDArray[np.float32] | None = None
        self._detected = np.empty((0, 0), np.float32)
        self._corrected = np.empty((0, 0), np.uint8)
        module.cracks_shown.connect(self._on_cracks)
        review.data.changed.connect(self._on_review)
        review.data.subject_changed.connect(self._on_subject)

    def _on_cracks(self, cracks: NDArray[np.float32] | None) -> None:
        if cracks is None:
            self._marks.hide_until_put()
            self._of = None
        else:
            self._show_marks(ALL_MARKS)

    def _on_subject(self, _: Subject | None) -> None:
        self._show_marks(ALL_MARKS)

    def _on_review(self, change: ReviewChange) -> None:
        if change.has_marks:
            self._show_marks(change)

    def _show_marks(self, change: ReviewChange) -> None:
        subject, cracks = self._review.data.subject, self._module.cracks
        if subject is None or subject.cracks is None or subject.cracks.probability is not cracks:
            self._marks.drop()
            self._of = None
            return
        corrections = self._review.cells.corrections
        if not corrections:
            self._marks.drop()
            if self._of is not None and self._module.has_cracks:
                self._module.put_cracks(cracks)
            self._of = None
            return
        if self._of is not cracks or change.all_marks:
            self._of, self._detected = cracks, cracks.copy()
            self._corrected = np.zeros(cracks.shape, np.uint8)
            changed = frozenset(corrections)
        else:
            changed = change.marks
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
