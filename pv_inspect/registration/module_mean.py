"""The mean of all frames on the module plane, and how alike a frame is to it."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from pv_inspect.geometry.camera import Camera
from pv_inspect.geometry.grid import HrGrid
from pv_inspect.registration.alignment import accumulate_frame
from pv_inspect.registration.registration import Registration
from pv_inspect.sequence.sequence import FrameSequence

__all__ = ["blur", "detail_correlation", "indices", "module_mean"]

Array = NDArray[np.float64]
Image = NDArray[np.float32]


def module_mean(
    sequence: FrameSequence, registration: Registration, grid: HrGrid
) -> tuple[Image, NDArray[np.bool_]]:
    """Mean of all used frames on a grid of the module plane.

    Returns
    -------
    (H, W) float32
        Mean of (g_i - offset_i) / gain_i; 0 where no frame sees the module.
    (H, W) bool
        Where at least one frame sees the module.
    """
    total = np.zeros(grid.shape, np.float32)
    weight = np.zeros(grid.shape, np.float32)
    camera = registration.camera
    for index in indices(registration.used):
        frame = sequence.frame(index)
        accumulate_frame(
            total,
            weight,
            frame.image,
            frame.valid,
            registration.homographies[index] @ grid.matrix,
            camera.K,
            camera.kappa,
            float(registration.gain[index]),
            float(registration.offset[index]),
        )
    covered = weight > 0
    return np.divide(total, weight, out=np.zeros_like(total), where=covered), covered


def blur(image: Image, sigma: float) -> Image:
    """Blur an image; sigma in its pixels, 0 leaves it as it is."""
    return np.asarray(cv2.GaussianBlur(image, (0, 0), sigma), np.float32) if sigma > 0 else image


def detail_correlation(
    image: Image,
    camera: Camera,
    homography: Array,
    module: Image,
    covered: NDArray[np.bool_],
    grid: HrGrid,
) -> float:
    """Correlation of one frame with the module image in what tells its cells apart.

    Slow brightness is taken out, and so is the mean cell of each size: gaps and busbars look the
    same on every module.
    """
    total = np.zeros(grid.shape, np.float32)
    weight = np.zeros(grid.shape, np.float32)
    valid = np.ones(image.shape, bool)
    accumulate_frame(
        total, weight, image, valid, homography @ grid.matrix, camera.K, camera.kappa, 1.0, 0.0
    )
    seen = covered & (weight > 0)
    scale = grid.magnification
    detail = [blur(a, 1.5 * scale) - blur(a, 6.0 * scale) for a in (total, module)]
    layout = grid.layout
    slices = [
        grid.cell_slices(row, col) for row in range(layout.rows) for col in range(layout.cols)
    ]
    slices = [cell for cell in slices if seen[cell].all()]
    if not slices:
        return 0.0
    products = []
    for size in dict.fromkeys(detail[0][cell].shape for cell in slices):
        alike = [cell for cell in slices if detail[0][cell].shape == size]
        a, b = (np.array([d[cell] for cell in alike]) for d in detail)
        if len(slices) > 1:
            a, b = a - a.mean(axis=0), b - b.mean(axis=0)
        products.append(((a * b).sum(), (a * a).sum(), (b * b).sum()))
    ab, aa, bb = (sum(of_sizes) for of_sizes in zip(*products, strict=True))
    return float(ab / np.sqrt(aa * bb + 1e-30))


def indices(used: NDArray[np.bool_]) -> list[int]:
    """Return the indices of the frames in use."""
    return [int(index) for index in np.flatnonzero(used)]
