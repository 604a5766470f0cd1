"""Drags points as napari does, which has no public call for it: its private names stand here."""

from __future__ import annotations

from typing import Any

import numpy as np


def press(layer: Any, start: Any) -> None:
    """Press the button over the selected points; ``start``: frame, row, column."""
    layer._set_drag_start(layer.selected_data, start)


def move_to(layer: Any, position: Any) -> None:
    """Move the mouse with the button down: napari blocks its data event until the release."""
    with layer.events.data.blocker():
        layer._move(layer.selected_data, np.asarray(position))


def release_at(layer: Any, position: Any) -> None:
    """Let the button go."""
    layer._move(layer.selected_data, np.asarray(position))
    layer._drag_start = None
