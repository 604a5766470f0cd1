"""A layer that is made when there is data, and made again if the user deleted it."""

from __future__ import annotations

from typing import Any

from napari.components import ViewerModel
from napari.layers import Layer
from numpy.typing import NDArray

__all__ = ["LayerSlot"]


class LayerSlot:
    """Holds at most one layer of a viewer.

    Parameters
    ----------
    viewer : napari viewer
    kind : type
        Layer class.
    **appearance
        Attributes for a new layer; afterwards they belong to the user.
    """

    def __init__(self, viewer: ViewerModel, kind: type[Layer], **appearance: Any) -> None:
        self._viewer = viewer
        self._kind = kind
        self._appearance = appearance
        self._layer: Layer | None = None
        self._visible_before: bool | None = None

    @property
    def layer(self) -> Layer | None:
        """The layer, None if there is none or if the user deleted it."""
        if self._layer is not None and self._layer not in self._viewer.layers:
            self._layer = None
        return self._layer

    def put(self, data: Any, **attributes: Any) -> Layer:
        """Show ``data``; ``attributes`` are set every time."""
        layer = self.layer
        if layer is None:
            selected = self._viewer.layers.selection.active
            layer = self._kind(data, **{**self._appearance, **attributes})
            # Known before it is added: adding moves the time slider, whose followers may put again.
            self._layer = layer
            self._viewer.add_layer(layer)
            # A new layer of ours takes the user's tools away from what they were on.
            if selected is not None and selected in self._viewer.layers:
                self._viewer.layers.selection.active = selected
        else:
            layer.data = data
            for name, value in attributes.items():
                setattr(layer, name, value)
            if self._visible_before is not None:
                layer.visible = self._visible_before
        self._visible_before = None
        return layer

    def redraw(self, data: NDArray[Any], **attributes: Any) -> Layer:
        """Show ``data`` as `put` does, at a fraction of the cost where only numbers differ.

        Extent and thumbnail stay as they were: for what moves a little while it is dragged.
        """
        layer = self.layer
        if layer is None or self._visible_before is not None or layer.data.shape != data.shape:
            return self.put(data, **attributes)
        # napari draws anew at each attribute: here once, at the end.
        with layer.events.blocker_all():
            layer.data[...] = data
            for name, value in attributes.items():
                setattr(layer, name, value)
        layer.refresh(thumbnail=False, extent=False)
        return layer

    def hide_until_put(self) -> None:
        """Hide the layer until something is put into it again."""
        if (layer := self.layer) is not None and self._visible_before is None:
            self._visible_before = layer.visible
            layer.visible = False

    def use(self, layer: Layer) -> None:
        """Hold a layer that something else has added to the viewer."""
        self._layer = layer

    def drop(self) -> None:
        """Remove the layer from the viewer."""
        if (layer := self.layer) is not None:
            self._viewer.layers.remove(layer)
        self._layer = self._visible_before = None
