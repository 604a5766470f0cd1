"""The sequence as one lazy stack, with a caption that says what became of the shown frame."""

from __future__ import annotations

from textwrap import fill
from typing import Any

from napari.components import ViewerModel
from napari.layers import Image, Layer
from psygnal import Signal

from napari_pv_inspect.appearance import FRAMES
from napari_pv_inspect.layers.layer_data import SEQUENCE_KEY, sequence_layer
from napari_pv_inspect.layers.slot import LayerSlot
from napari_pv_inspect.models.workbench import WorkbenchModel
from pv_inspect.inspection.figures import REGISTRATION_RESIDUAL, RESIDUAL
from pv_inspect.inspection.inspection import Inspection
from pv_inspect.sequence.sequence import FrameSequence

__all__ = ["FramesLayer", "frame_caption"]

CAPTION_LETTERS = 90


class FramesLayer:
    """Keeps the frames layer and the caption in step with the model."""

    frame_shown = Signal(int)

    def __init__(self, viewer: ViewerModel, model: WorkbenchModel) -> None:
        self._viewer = viewer
        self._model = model
        self._slot = LayerSlot(viewer, Image)
        model.sequence_changed.connect(self._on_sequence)
        model.changed.connect(self._caption)
        viewer.dims.events.current_step.connect(self._on_step)

    def take_layer(self, layer: Layer) -> bool:
        """Make a layer of the reader the frames layer; False if it carries no sequence."""
        sequence = layer.metadata.get(SEQUENCE_KEY)
        if not isinstance(sequence, FrameSequence) or layer is self._slot.layer:
            return False
        if (earlier := self._slot.layer) is not None:
            self._slot.drop()
            layer.name = earlier.name
        self._slot.use(layer)
        if sequence is not self._model.sequence:
            self._model.open(sequence)
        return True

    def close(self) -> None:
        """Disconnect from the viewer."""
        self._viewer.dims.events.current_step.disconnect(self._on_step)

    @property
    def frame(self) -> int:
        """Index of the frame under the time slider."""
        # Counted from the end: a layer of the user's own may bring another axis.
        return int(self._viewer.dims.current_step[-3]) if self._viewer.dims.ndim > 2 else 0

    def show(self, frame: int) -> None:
        """Move the time slider."""
        if self._viewer.dims.ndim > 2 and frame != self.frame:
            self._viewer.dims.set_current_step(self._viewer.dims.ndim - 3, frame)

    def bring_back(self) -> None:
        """Show the frames again if the user deleted them."""
        if self._slot.layer is None:
            self._on_sequence(self._model.sequence)

    def _on_sequence(self, sequence: FrameSequence | None) -> None:
        layer = self._slot.layer
        if layer is None or layer.metadata.get(SEQUENCE_KEY) is not sequence:
            # It would hold on to its frames, and stretch the time slider.
            self._slot.drop()
        if sequence is not None and self._slot.layer is None:
            data, attributes, _ = sequence_layer(sequence)
            layer = Image(data, **{**attributes, "name": FRAMES})
            # The slot knows the layer before the viewer tells that it was added.
            self._slot.use(layer)
            self._viewer.add_layer(layer)

    def _on_step(self, _: Any = None) -> None:
        self._caption()
        if self._viewer.dims.ndim > 2:
            self.frame_shown.emit(self.frame)

    def _caption(self) -> None:
        overlay = self._viewer.canvas.overlays.text
        text = ""
        if (sequence := self._model.sequence) is not None and self.frame < len(sequence):
            # The overlay does not wrap: what is too long would run out of the canvas.
            shown = None if self._model.why_hidden else self._model.shown
            text = fill(frame_caption(sequence, shown, self.frame), CAPTION_LETTERS)
        overlay.position = "top_left"
        overlay.font_size = 8
        overlay.text = text
        overlay.visible = bool(text)


def frame_caption(sequence: FrameSequence, inspection: Inspection | None, frame: int) -> str:
    """Return name, fit and status of one frame in one line."""
    name = sequence.names[frame]
    if (reason := sequence.no_measurements.get(frame)) is not None:
        return f"{name}   not used: {reason}"
    if inspection is None or inspection.calibration is None:
        if inspection is not None and inspection.crossings is not None:
            why = inspection.crossings.frames[frame].why
            return f"{name}   rejected: {why}" if why else f"{name}   crossing points found"
        return name
    fit = inspection.registration or inspection.calibration
    if not fit.used[frame]:
        return f"{name}   rejected: {fit.why[frame]}"
    text = f"{name}   used   grid fits to {inspection.calibration.rms_px[frame]:.2f} px"
    if inspection.reconstruction is not None:
        text += f"   {RESIDUAL} {inspection.reconstruction.residual_rms[frame]:.2f} x noise"
    elif inspection.registration is not None:
        text += f"   {REGISTRATION_RESIDUAL} {inspection.registration.rms[frame]:.2f} x noise"
    return text
