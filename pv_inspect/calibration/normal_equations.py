"""The damped normal equations of the bundle adjustment, the poses eliminated."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

__all__ = ["NormalEquations"]

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class NormalEquations:
    """``[[A, B], [B^T, C]] [homographies; common] = [a; c]``, A with one block per frame."""

    A: Array
    B: Array
    C: Array
    a: Array
    c: Array

    def solve(self, damping: float) -> tuple[Array, Array]:
        """Levenberg-Marquardt step: (n_frames, 8) and (n_free,).

        Raises
        ------
        numpy.linalg.LinAlgError
            If the equations are singular.
        """
        diagonal = np.einsum("kii->ki", self.A)
        A = self.A + np.einsum("ki,ij->kij", damping * diagonal, np.eye(8))
        C = self.C + damping * np.diag(np.diag(self.C))
        AB = np.linalg.solve(A, self.B)
        Aa = np.linalg.solve(A, self.a[..., None])[..., 0]
        schur = C - np.einsum("kip,kiq->pq", self.B, AB)
        common = np.linalg.solve(schur, self.c - np.einsum("kip,ki->p", self.B, Aa))
        return Aa - AB @ common, common

    def common_covariance(self) -> Array:
        """Covariance of the free common parameters, homographies marginalised."""
        schur = self.C - np.einsum("kip,kiq->pq", self.B, np.linalg.pinv(self.A) @ self.B)
        return np.asarray(np.linalg.pinv(schur, hermitian=True))
