"""Endings of the files that frames are read from: the one place that lists them.

Imports nothing, so that programs can ask before they load anything.
"""

from __future__ import annotations

from pathlib import PurePath

__all__ = ["ENDINGS", "FRAME_ENDINGS", "PATTERNS", "is_frame_file"]

ENDINGS = {
    "TIFF": (".tif", ".tiff"),
    "PNG": (".png",),
    "JPEG": (".jpg", ".jpeg", ".jpe"),
    "BMP": (".bmp",),
    "NumPy": (".npy", ".npz"),
    "FITS": (".fits", ".fit", ".fts"),
    "HDF5": (".h5", ".hdf5", ".nxs"),
    "video": (".avi", ".mp4", ".m4v", ".mov", ".mkv", ".mjpeg", ".mjpg"),
}
"""Of every format, in small letters, with the dot."""

FRAME_ENDINGS = tuple(ending for endings in ENDINGS.values() for ending in endings)
"""Of all formats."""

PATTERNS = " ".join(f"*{ending}" for ending in FRAME_ENDINGS)
"""As dialogs want them."""


def is_frame_file(path: PurePath) -> bool:
    """Whether the name of a file says that frames can be read from it."""
    return path.suffix.lower() in FRAME_ENDINGS
