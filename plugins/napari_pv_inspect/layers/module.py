"""Module image, support and crack overlay beside the frames, at the same scale."""

from __future__ import annotations

import numpy as np
from napari.components import ViewerModel
from napari.layers import Image, Layer
from numpy.typing import NDArray
from psygnal import Signal

from napari_pv_inspect import appearance
from napari_pv_inspect.layers.attributes import MODULE_PARTS, attributes_of
from napari_pv_inspect.layers.layer_data import PART_KEY
from napari_pv_inspect.layers.placement import Placement, module_placement
from napari_pv_inspect.layers.slot import LayerSlot
from napari_pv_inspect.models.workbench import WorkbenchModel
from pv_inspect.geometry.grid import HrGrid
from pv_inspect.inspection.inspection import Inspection
from pv_inspect.sequence.sequence import FrameSequence
from pv_inspect.settings import Settings

__all__ = ["ModuleLayers"]


class ModuleLayers:
    """Keeps the layers of the module plane in step with the model.

    Attributes
    ----------
    cracks : (h, w) float32 or None
        Crack probability that the module image is shown with.
    """

    cracks_shown = Signal(object)

    def __init__(self, viewer: ViewerModel, model: WorkbenchModel) -> None:
        self._viewer = viewer
        self._model = model
        self._shown: object = None
        self.cracks: NDArray[np.float32] | None = None
        self.placement: Placement | None = None
        self.grid: HrGrid | None = None
        self.shape = (0, 0)
        self._contrast_is_final = False
        self._slots = {
            part: LayerSlot(viewer, Image, **attributes_of(part)) for part in MODULE_PARTS
        }
        self._image, self._support, self._consistency, self._cracks = self._slots.values()
        model.sequence_changed.connect(self._on_sequence)
        model.inspection_changed.connect(self._on_inspection)
        model.result_opened.connect(self._on_inspection)
        model.settings_changed.connect(self._on_settings)

    def preview(self, image: NDArray[np.float32]) -> None:
        """Show an intermediate image in place of the module image."""
        inspection = self._model.shown
        if inspection is None or inspection.registration is None:
            return
        scale = inspection.registration.lr_px_per_unit
        grid = HrGrid.covering(inspection.layout, scale, self._model.run_settings.magnification)
        self._put_image(image, grid)
        self._shown = None
        # An overlay of an earlier image does not belong to this one.
        self._support.hide_until_put()
        self._consistency.hide_until_put()
        self._cracks.hide_until_put()
        self._set_cracks(None)

    def _on_sequence(self, _: FrameSequence | None) -> None:
        self._clear()

    def _clear(self) -> None:
        for slot in self._slots.values():
            slot.drop()
        self._contrast_is_final = False
        self._shown = self.placement = self.grid = None
        self._set_cracks(None)

    def _on_inspection(self, inspection: Inspection | None) -> None:
        if inspection is None:
            return
        if self._model.why_hidden:
            if self.grid is not None:
                self._clear()
                self._viewer.reset_view()
            return
        if (made := inspection.reconstruction) is None:
            if self.grid is not None and self.grid.layout != inspection.layout:
                # The image of other rows and columns is none of this module.
                self._clear()
                # The camera may look at where a cell was.
                self._viewer.reset_view()
            return
        if made is not self._shown:
            self._put_image(made.image, made.grid)
            self._contrast_is_final = True
            assert self.placement is not None
            place = self.placement
            self._support.put(made.support, scale=place.scale, translate=place.translate)
            self._consistency.put(made.consistency, scale=place.scale, translate=place.translate)
            self._shown = made
        cracks = None if inspection.cracks is None else inspection.cracks.probability
        if cracks is not None and cracks is not self.cracks:
            self.put_cracks(cracks)
            self._set_cracks(cracks)

    def _on_settings(self, _: Settings) -> None:
        # A hidden image comes back with its rows and columns.
        if self._model.why_hidden or self.grid is None:
            self._on_inspection(self._model.shown)

    def bring_back(self) -> None:
        """Show the layers again that the user deleted."""
        if all(slot.layer is not None for slot in self._slots.values()):
            return
        self._shown = self.cracks = None
        self._on_inspection(self._model.shown or self._model.result)

    @property
    def has_cracks(self) -> bool:
        """Whether there is a layer of cracks; the user may have deleted it."""
        return self._cracks.layer is not None

    def put_cracks(self, cracks: NDArray[np.float32]) -> None:
        """Show a crack map of the module image that is shown, anew if its content has changed."""
        layer = self._cracks.layer
        if layer is not None and layer.data is cracks:
            layer.refresh()
        elif self.placement is not None:
            place = self.placement
            self._cracks.put(cracks, scale=place.scale, translate=place.translate)

    def take_layer(self, layer: Layer) -> None:
        """Make a layer of the reader ours, in place of the one that was."""
        slot = self._slots.get(layer.metadata.get(PART_KEY))
        if slot is not None and slot.layer is not layer:
            slot.drop()
            slot.use(layer)

    def _set_cracks(self, cracks: NDArray[np.float32] | None) -> None:
        self.cracks = cracks
        self.cracks_shown.emit(cracks)

    def _put_image(self, image: NDArray[np.float32], grid: HrGrid) -> None:
        self.grid, self.shape = grid, image.shape
        self.placement = module_placement(grid, image.shape, self._frame_shape)
        first = self._image.layer is None
        place = {"scale": self.placement.scale, "translate": self.placement.translate}
        if first or not self._contrast_is_final:
            # Afterwards the contrast is the user's: images of two settings are to be compared.
            place["contrast_limits"] = appearance.contrast_limits(image)
        self._image.put(image, **place)
        if first:
            self._viewer.reset_view()

    @property
    def _frame_shape(self) -> tuple[int, int] | None:
        return None if self._model.sequence is None else self._model.sequence.shape
