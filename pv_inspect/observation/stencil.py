"""Symmetric operators that couple each pixel with its 5 x 5 neighbourhood."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numba
import numpy as np
from numpy.typing import NDArray

from pv_inspect.common.compiling import compiled

__all__ = ["OFFSETS", "Quadratic", "Stencil", "dot"]

Image = NDArray[np.floating]

# (dy, dx) of the partners that follow a pixel in row-major order; the other 12 follow by symmetry.
OFFSETS = np.array(
    [(0, 0), (0, 1), (0, 2)] + [(dy, dx) for dy in (1, 2) for dx in range(-2, 3)], dtype=np.int64
)


class Quadratic(Protocol):
    """A symmetric operator L on (height, width) images, of the form f' L f / 2."""

    @property
    def diagonal(self) -> Image:
        """The operator's diagonal, (height, width)."""

    def apply(self, image: Image) -> Image:
        """L f, (height, width)."""


@dataclass(frozen=True, eq=False)
class Stencil:
    """Symmetric 25-point operator with its own coefficients for every pixel.

    Parameters
    ----------
    planes : (13, height, width) float32 or float64
        ``planes[k, y, x]`` couples pixel (y, x) with its partner at ``OFFSETS[k]``, both ways;
        plane 0 is the diagonal. Coefficients whose partner is outside of the image are ignored.
    """

    planes: NDArray[np.floating]

    @classmethod
    def zeros(cls, shape: tuple[int, int], dtype: type[np.floating] = np.float32) -> Stencil:
        """Return the zero operator on images of a shape (height, width)."""
        return cls(np.zeros((len(OFFSETS), *shape), dtype))

    @property
    def diagonal(self) -> NDArray[np.floating]:
        """The operator's diagonal, (height, width)."""
        return np.asarray(self.planes[0])

    def apply(self, image: NDArray[np.floating]) -> NDArray[np.floating]:
        """Apply the operator to a (height, width) image.

        Notes
        -----
        ``out[x] = d_0[x] f[x] + sum_k (d_k[x] f[x + o_k] + d_k[x - o_k] f[x - o_k])``.
        """
        out = np.empty_like(image)
        _apply(self.planes, image, out)
        return out


def dot(a: Image, b: Image) -> float:
    """Return the inner product of two images with float64 sums in a fixed order."""
    rows = np.empty(a.shape[0])
    _dot_rows(a, b, rows)
    return float(rows.sum())


@compiled(parallel=True, fastmath={"contract", "reassoc"})
def _dot_rows(a, b, rows):  # type: ignore[no-untyped-def]
    for y in numba.prange(a.shape[0]):
        s = 0.0
        for x in range(a.shape[1]):
            s += np.float64(a[y, x]) * np.float64(b[y, x])
        rows[y] = s


@compiled(parallel=True, fastmath={"contract"})
def _apply(planes, f, out):  # type: ignore[no-untyped-def]
    """Slices instead of shifted indices: only then do the loops become vector instructions."""
    height, width = f.shape
    for y in numba.prange(height):
        row, here, d = out[y], f[y], planes[0, y]
        for x in range(width):
            row[x] = d[x] * here[x]
        for k in range(1, 13):
            dy, dx = OFFSETS[k]
            lo, hi = max(0, -dx), min(width, width - dx)
            if y + dy < height:
                to, d, g = row[lo:hi], planes[k, y, lo:hi], f[y + dy, lo + dx : hi + dx]
                for x in range(len(to)):
                    to[x] += d[x] * g[x]
            if y - dy >= 0:
                to, d, g = row[lo + dx : hi + dx], planes[k, y - dy, lo:hi], f[y - dy, lo:hi]
                for x in range(len(to)):
                    to[x] += d[x] * g[x]
