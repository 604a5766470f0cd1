"""What conjugate gradients ask for instead of the operator's inverse, in the frequency domain.

The data's normal operator is nearly a convolution: what a frequency of the image leaves in the
frames falls by orders of magnitude from the lowest to the highest. A diagonal knows nothing of it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numba
import numpy as np
from numpy.typing import NDArray
from scipy import fft
from scipy.ndimage import uniform_filter

__all__ = ["Spectral"]

Image = NDArray[np.floating]

_SEED = 11
# Zeros around the image, HR px: a convolution that goes round would join opposite edges.
_PADDING = 24
# The symbol is averaged over this share of the frequencies along each axis, and as many at least.
_AVERAGED, _LEAST_AVERAGED = 1 / 40, 9
# Smallest value of the symbol, of its largest.
_FLOOR = 0.01


@dataclass(frozen=True, eq=False)
class Spectral:
    """Approximate inverse ``M = D^-1/2 P' F^-1 (1 / c) F P D^-1/2`` of an operator H.

    Parameters
    ----------
    shape : (height, width)
        Of the Fourier transform F; P pads with zeros.
    inverse : (height, width // 2 + 1) float32
        1 / c with the symbol c > 0: the mean answer of ``D^-1/2 H D^-1/2`` to every frequency.

    Notes
    -----
    M is symmetric and positive whatever c. D is given anew with every application: c tells
    frequencies from each other and stays good while the prior's weights move.
    """

    shape: tuple[int, int]
    inverse: Image

    @classmethod
    def of(cls, operator: Callable[[Image], Image], root: Image) -> Spectral:
        """Measure the symbol with a probe of white noise: one application of the operator.

        Parameters
        ----------
        operator : callable
            H, symmetric and positive.
        root : (height, width) float32
            D^-1/2.
        """
        height, width = (n + _PADDING for n in root.shape)
        shape = (int(fft.next_fast_len(height)), int(fft.next_fast_len(width, real=True)))
        signs = np.random.default_rng(_SEED).integers(0, 2, root.shape, np.int8)
        z = (2 * signs - 1).astype(root.dtype)
        sent = _spectrum(z, shape)
        answer = _spectrum(root * operator(root * z), shape)
        over = [max(int(n * _AVERAGED), _LEAST_AVERAGED) | 1 for n in sent.shape]
        product, power = (
            uniform_filter(a, over, mode=("wrap", "reflect"))
            for a in ((sent.conj() * answer).real, (sent.conj() * sent).real)
        )
        symbol = product / np.maximum(power, 1e-3 * float(power.mean()))
        floor = max(_FLOOR * float(symbol.max()), float(np.finfo(np.float32).tiny))
        return cls(shape, (1.0 / np.maximum(symbol, floor)).astype(root.dtype))

    def apply(self, image: Image, root: Image) -> Image:
        """M of a (height, width) image, with D^-1/2."""
        spectrum = _spectrum(root * image, self.shape)
        spectrum *= self.inverse
        whole = fft.irfft2(spectrum, self.shape, workers=numba.get_num_threads(), overwrite_x=True)
        return np.asarray(root * whole[: image.shape[0], : image.shape[1]], image.dtype)


def _spectrum(image: Image, shape: tuple[int, int]) -> NDArray[np.complexfloating]:
    return np.asarray(fft.rfft2(image, shape, workers=numba.get_num_threads()))
