"""Training cells as other cameras, other optics and super-resolution would show them."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from pv_inspect.cracks.classes import CRACK
from pv_inspect.cracks.network import CELL_PX, normalised
from pv_inspect.cracks.training.diversified import Diversity, with_fingers, with_other_metal

__all__ = ["Augmentation", "prepared"]

Image = NDArray[np.float32]
Label = NDArray[np.uint8]

# Cracks are thin: a pixel of the smaller label belongs to one from this share on.
_CRACK_SHARE = 0.35


@dataclass(frozen=True)
class Augmentation:
    """What happens to a training cell.

    Parameters
    ----------
    degrade : bool
        Blur, coarser sampling, noise, brightness and cut corners; without it cells are only
        turned, flipped and moved a little.
    diversity : Diversity, optional
        Cells of other makers; without it they keep their own metallisation.
    """

    degrade: bool = True
    diversity: Diversity | None = None

    def __call__(self, image: Label, label: Label, rng: np.random.Generator) -> tuple[Image, Label]:
        """Draw one version of a cell.

        Parameters
        ----------
        image, label : (h, w) uint8
            As `prepared` returns them.
        rng : numpy Generator

        Returns
        -------
        image : (h, w) float32
            Input of the network, `normalised`.
        label : (h, w) uint8
        """
        seen = _array(image) / np.float32(255)
        if self.diversity is not None:
            seen, label = with_other_metal(seen, label, rng, self.diversity)
        seen, label = _moved(seen, label, rng)
        if self.diversity is not None and rng.random() < self.diversity.fingers:
            seen = with_fingers(seen, label, rng)
        if self.degrade:
            seen, label = _corners_cut(seen, label, rng)
            seen = _exposed(_coarser(_lit(seen, rng), rng), rng)
        return normalised(seen), label


def prepared(image: Label, label: Label) -> tuple[Label, Label]:
    """Bring a cell and its label to the working size.

    Parameters
    ----------
    image, label : (h, w) uint8

    Returns
    -------
    image, label : uint8
        Longer side `CELL_PX`.
    """
    scale = CELL_PX / max(image.shape)
    size = (round(image.shape[1] * scale), round(image.shape[0] * scale))
    way = cv2.INTER_AREA if scale < 1 else cv2.INTER_LINEAR
    small = cv2.resize(label, size, interpolation=cv2.INTER_NEAREST)
    share = cv2.resize((label == CRACK).astype(np.float32), size, interpolation=way)
    small[small == CRACK] = 0
    small[share >= _CRACK_SHARE] = CRACK
    return np.asarray(cv2.resize(image, size, interpolation=way)), np.asarray(small)


def _moved(image: Image, label: Label, rng: np.random.Generator) -> tuple[Image, Label]:
    """Turned, flipped, and as a grid that is slightly off would have cut it."""
    turns = int(rng.integers(4))
    image, label = np.rot90(image, turns), np.rot90(label, turns)
    if rng.random() < 0.5:
        image, label = image[:, ::-1], label[:, ::-1]
    image, label = np.ascontiguousarray(image), np.ascontiguousarray(label)
    h, w = image.shape
    matrix = cv2.getRotationMatrix2D(
        ((w - 1) / 2, (h - 1) / 2), rng.normal(0, 1.0), rng.uniform(0.94, 1.08)
    )
    matrix[:, 2] += rng.uniform(-0.02, 0.02, 2) * max(h, w)
    edge = cv2.BORDER_REPLICATE
    moved = cv2.warpAffine(image, matrix, (w, h), flags=cv2.INTER_CUBIC, borderMode=edge)
    classes = cv2.warpAffine(label, matrix, (w, h), flags=cv2.INTER_NEAREST)
    return np.asarray(moved, np.float32), np.asarray(classes, np.uint8)


def _corners_cut(image: Image, label: Label, rng: np.random.Generator) -> tuple[Image, Label]:
    """Corners of wafers from round ingots."""
    if rng.random() > 0.35:
        return image, label
    h, w = image.shape
    y, x = np.mgrid[:h, :w].astype(np.float32)
    size, level = rng.uniform(0.03, 0.1) * CELL_PX, rng.uniform(0, 0.4)
    soft = rng.uniform(1, 6)
    kept = np.ones((h, w), np.float32)
    for edge in (x + y, w - 1 - x + y, x + h - 1 - y, w - 1 - x + h - 1 - y):
        kept = np.minimum(kept, np.clip((edge - size) / soft + 0.5, 0, 1))
    return image * (level + (1 - level) * kept), np.where(kept < 0.5, np.uint8(0), label)


def _lit(image: Image, rng: np.random.Generator) -> Image:
    """Other brightness and contrast: gradients, response, stray light."""
    h, w = image.shape
    y, x = np.linspace(-1, 1, h)[:, None], np.linspace(-1, 1, w)[None]
    a = rng.normal(0, 0.08, 5)
    slope = np.exp(a[0] * x + a[1] * y + a[2] * x * x + a[3] * y * y + a[4] * x * y)
    image = np.maximum(image * slope.astype(np.float32), 0) ** np.float32(rng.uniform(0.6, 1.6))
    if rng.random() < 0.5:
        image = image + np.float32(rng.uniform(-0.05, 0.3) * image.max())
    return np.maximum(image, 0)


def _coarser(image: Image, rng: np.random.Generator) -> Image:
    """Blur, and sampling with fewer pixels, with the noise of that sampling."""
    h, w = image.shape
    if rng.random() < 0.65:
        sigma = rng.uniform(0.2, 2.0)
        turn = 2.0 ** rng.normal(0, 0.25)  # motion blur is not round
        image = _array(cv2.GaussianBlur(image, (0, 0), sigma * turn, sigmaY=sigma / turn))
    if rng.random() < 0.5:
        scale = rng.uniform(56, 200) / CELL_PX
        size = (max(round(w * scale), 4), max(round(h * scale), 4))
        down = cv2.INTER_AREA if rng.random() < 0.7 else cv2.INTER_LINEAR
        up = cv2.INTER_CUBIC if rng.random() < 0.7 else cv2.INTER_LINEAR
        image = _array(cv2.resize(image, size, interpolation=down))
        if rng.random() < 0.6:
            image = _exposed(image, rng)
        image = _array(cv2.resize(image, (w, h), interpolation=up))
    return image


def _exposed(image: Image, rng: np.random.Generator) -> Image:
    """Noise of the camera, and the overshoot of deblurring."""
    if rng.random() < 0.2:
        sharper = cv2.GaussianBlur(image, (0, 0), rng.uniform(0.7, 2.0))
        image = image + np.float32(rng.uniform(0, 1.2)) * (image - sharper)
    if rng.random() < 0.6:
        sigma = rng.uniform(0, 0.05) * float(image.mean())
        noise = rng.standard_normal(image.shape, np.float32)
        if rng.random() < 0.4:
            blur = rng.uniform(0.5, 1.2)  # what reconstruction makes of noise
            noise = cv2.GaussianBlur(noise, (0, 0), blur) * np.float32(2 * blur)
        image = image + np.float32(sigma) * noise
    return np.asarray(image, np.float32)


def _array(image: NDArray[np.generic]) -> Image:
    return np.asarray(image, np.float32)
