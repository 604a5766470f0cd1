"""The point spread function: optical Gaussian and square pixel aperture, on the HR grid."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeVar

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

__all__ = ["Blur", "footprint_variance_lr_px2", "kernel_of_variance"]

T = TypeVar("T", np.float32, np.float64)

# A Gaussian narrower than this is not represented by its samples at integers.
_MIN_SIGMA = 0.4


def footprint_variance_lr_px2(psf_sigma_lr_px: float) -> float:
    """Variance per axis of what one LR pixel sees: Gaussian optics and square aperture, LR px^2."""
    return psf_sigma_lr_px**2 + 1.0 / 12.0


@dataclass(frozen=True, eq=False)
class Blur:
    """Separable symmetric blur of an image, the B of W_i = S_i B; it is its own adjoint.

    Parameters
    ----------
    kernel_x, kernel_y : (2 r + 1,) float64
        Odd, symmetric, with sum 1.

    Notes
    -----
    The image continues beyond its border as its mirror image (half-sample symmetric). With a
    symmetric kernel the matrix of the blur is then exactly symmetric, and its rows sum to 1; a
    blur that is merely cropped has one of the two properties, not both.
    """

    kernel_x: NDArray[np.float64]
    kernel_y: NDArray[np.float64]

    @property
    def radius(self) -> int:
        """Reach of the kernels, HR pixels."""
        return max(len(self.kernel_x), len(self.kernel_y)) // 2

    @property
    def variances(self) -> tuple[float, float]:
        """Second moments of the kernels along x and y, HR px^2."""
        return _variance(self.kernel_x), _variance(self.kernel_y)

    def apply(self, image: NDArray[T]) -> NDArray[T]:
        """Blur a (height, width) float32 or float64 image; the result has its type."""
        return _separable(image, self.kernel_x, self.kernel_y)

    def apply_squared(self, image: NDArray[T]) -> NDArray[T]:
        """Filter with the squared kernels: the diagonal of B diag(image) B."""
        return _separable(image, self.kernel_x**2, self.kernel_y**2)


def kernel_of_variance(variance: float, box: float) -> NDArray[np.float64]:
    """Samples of a box convolved with a Gaussian, with an exact second moment.

    Parameters
    ----------
    variance : float
        Wanted second moment of the samples, HR px^2; what is not positive gives the identity.
    box : float
        Width of the box (the pixel aperture), HR px. It is narrowed if it alone exceeds the
        variance.

    Returns
    -------
    (2 r + 1,) float64
        Symmetric kernel with sum 1.

    Notes
    -----
    Samples of ``Phi((n + box/2) / s) - Phi((n - box/2) / s)``, s^2 = variance - box^2 / 12. The
    variance of the samples differs a little from that of the function; three more taps
    (e/2, 1 - e, e/2) make up the difference e.
    """
    if variance <= 0:
        return np.ones(1)
    if variance < 2.0 * _MIN_SIGMA**2:
        return np.array([variance / 2, 1.0 - variance, variance / 2])
    box = min(box, float(np.sqrt(12.0 * (variance - _MIN_SIGMA**2))))
    sigma = float(np.sqrt(variance - box**2 / 12.0))
    r = int(np.ceil(box / 2 + 3.7 * sigma))
    n = np.arange(-r, r + 1)
    kernel = ndtr((n + box / 2) / sigma) - ndtr((n - box / 2) / sigma)
    kernel /= kernel.sum()
    e = variance - _variance(kernel)
    kernel = np.convolve(kernel, [e / 2, 1.0 - e, e / 2])
    symmetric: NDArray[np.float64] = (kernel + kernel[::-1]) / 2
    return symmetric


def _variance(kernel: NDArray[np.float64]) -> float:
    n = np.arange(len(kernel)) - len(kernel) // 2
    return float((kernel * n**2).sum())


def _separable(
    image: NDArray[T], kernel_x: NDArray[np.float64], kernel_y: NDArray[np.float64]
) -> NDArray[T]:
    blurred = cv2.sepFilter2D(image, -1, kernel_x, kernel_y, borderType=cv2.BORDER_REFLECT)
    return np.asarray(blurred, dtype=image.dtype)
