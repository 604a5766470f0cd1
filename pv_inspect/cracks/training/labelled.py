"""Cells with labelled pixels: reading them, and splits for training and judging."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from pv_inspect.cracks.classes import CLASSES, CRACK
from pv_inspect.errors import InspectionError

__all__ = [
    "LabelledCell",
    "module_of",
    "read_labelled",
    "split_modules",
]

_IMAGES = (".png", ".jpg", ".jpeg", ".tif", ".tiff", ".bmp")


@dataclass(frozen=True, eq=False)
class LabelledCell:
    """Image of one cell and the class of each pixel.

    Parameters
    ----------
    name : str
        File name without its ending.
    image : (h, w) uint8
    label : (h, w) uint8
        Index into `CLASSES`.
    """

    name: str
    image: NDArray[np.uint8]
    label: NDArray[np.uint8]

    @property
    def crack(self) -> NDArray[np.bool_]:
        """Mask of the crack pixels."""
        return np.asarray(self.label == CRACK)


def read_labelled(folder: Path) -> list[LabelledCell]:
    """Read a folder of labelled cells: ``img/NAME.jpg`` and ``ann/NAME.png``.

    Parameters
    ----------
    folder : Path

    Returns
    -------
    list of LabelledCell
        In the order of the names.

    Raises
    ------
    InspectionError
        If there are no images, or a label is missing, has another size or an unknown class.
    """
    images = folder / "img"
    paths = sorted(p for p in images.glob("*") if p.suffix.lower() in _IMAGES)
    if not paths:
        raise InspectionError(
            f"{images} holds no images: give a folder with img/ (cells) and ann/ (their labels)."
        )
    return [_read(path, folder / "ann" / f"{path.stem}.png") for path in paths]


def _read(path: Path, label_path: Path) -> LabelledCell:
    image = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
    if image is None:
        raise InspectionError(f"{path} can't be read as an image: remove or replace it.")
    label = cv2.imread(str(label_path), cv2.IMREAD_UNCHANGED) if label_path.is_file() else None
    if label is None or label.shape != image.shape:
        got = "is missing" if label is None else f"is {label.shape}, the image {image.shape}"
        raise InspectionError(
            f"{label_path} {got}: each cell needs a one-channel label image of its size."
        )
    if label.max() >= len(CLASSES):
        raise InspectionError(
            f"{label_path} has class {label.max()}, but classes are 0 to {len(CLASSES) - 1} "
            f"({', '.join(CLASSES)})."
        )
    return LabelledCell(path.stem, np.asarray(image, np.uint8), np.asarray(label, np.uint8))


def module_of(name: str) -> str:
    """Return the module of a cell, which its file name begins with: ``EL104_11`` is of EL104."""
    return name.rpartition("_")[0] or name


def split_modules(
    cells: Sequence[LabelledCell], share: float = 0.15, seed: int = 0
) -> tuple[list[LabelledCell], list[LabelledCell]]:
    """Split cells so that no module has cells in both parts.

    Parameters
    ----------
    cells : sequence of LabelledCell
    share : float
        Least share of the cells that goes to the second part.
    seed : int
        For the order in which modules are drawn.

    Returns
    -------
    tuple of two lists of LabelledCell
        For training and for judging.
    """
    modules = sorted({module_of(cell.name) for cell in cells})
    np.random.default_rng(seed).shuffle(modules)
    held: set[str] = set()
    for module in modules:
        if sum(module_of(cell.name) in held for cell in cells) >= share * len(cells):
            break
        held.add(module)
    return (
        [cell for cell in cells if module_of(cell.name) not in held],
        [cell for cell in cells if module_of(cell.name) in held],
    )
