"""The classes that cells are labelled with, and that a network tells apart."""

from __future__ import annotations

__all__ = ["BUSBAR", "CLASSES", "CRACK"]

# Order of the classes in label images and of the channels of the network.
CLASSES = ("background", "dark", "cross", "crack", "busbar")
CRACK, BUSBAR = CLASSES.index("crack"), CLASSES.index("busbar")
