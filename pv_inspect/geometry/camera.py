"""The camera: from the module plane to pixels and back (paper, Eqs. 2-5 and App. A)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pv_inspect.errors import InspectionError

__all__ = ["Camera", "ProjectionDerivatives"]

Array = NDArray[np.float64]

# A point on the fold may come out of `distort` a few ulp beyond it.
_FOLD_SLACK = 8.0 * float(np.finfo(np.float64).eps)


@dataclass(frozen=True, eq=False)
class ProjectionDerivatives:
    """Pixels of n module points and their derivatives; rows without an image are NaN.

    Parameters
    ----------
    px : (n, 2) float64
        Pixel positions (x, y).
    d_module : (n, 2, 2) float64
        d px / d (x, y) of the module plane.
    d_homography : (n, 2, 8) float64
        d px / d (h11, h12, h13, h21, h22, h23, h31, h32) with h33 held where it is.
    d_kappa : (n, 2) float64
        d px / d kappa.
    d_intrinsics : (n, 2, 4) float64
        d px / d (fx, fy, cx, cy).
    """

    px: Array
    d_module: Array
    d_homography: Array
    d_kappa: Array
    d_intrinsics: Array


@dataclass(frozen=True, eq=False)
class Camera:
    """Pinhole camera with one radial distortion coefficient.

    A homography H (3 x 3) per frame maps the module plane to normalised image coordinates with
    a positive third component for what lies in front of the camera.

    Parameters
    ----------
    K : (3, 3) float64
        Intrinsic matrix [[fx, skew, cx], [0, fy, cy], [0, 0, 1]], LR px.
    kappa : float
        Radial distortion in normalised coordinates about the principal point.

    Raises
    ------
    InspectionError
        If K is no intrinsic matrix or kappa is not finite.

    Notes
    -----
    ``x_px = K d(H [x, y, 1]^T)`` (Eq. 3) with ``d(y) = y r_d / r_u`` (Eq. 4) and
    ``r_d = r_u + kappa r_u^3`` (Eq. 5). For kappa < 0 the radius r_d grows only up to the fold
    r_u^2 = -1 / (3 kappa), r_d^2 = -4 / (27 kappa). Beyond it there is no valid image and no ray:
    all functions give NaN there.
    """

    K: Array
    kappa: float

    def __post_init__(self) -> None:
        K = np.array(self.K, dtype=np.float64)
        if K.shape != (3, 3) or not np.isfinite(K).all() or K[2].tolist() != [0.0, 0.0, 1.0]:
            raise InspectionError(
                "The camera matrix K must be 3 x 3 with finite numbers and the last row 0 0 1, "
                f"but is {np.asarray(self.K).tolist()}: give [[fx, 0, cx], [0, fy, cy], [0, 0, 1]]."
            )
        if not (K[0, 0] > 0 and K[1, 1] > 0 and K[1, 0] == 0):
            raise InspectionError(
                f"The focal lengths in K must be positive, but are {K[0, 0]:g} and {K[1, 1]:g} px: "
                "give [[fx, 0, cx], [0, fy, cy], [0, 0, 1]]."
            )
        if not np.isfinite(self.kappa):
            raise InspectionError(f"The distortion kappa is {self.kappa}: give a finite number.")
        K.setflags(write=False)
        object.__setattr__(self, "K", K)
        object.__setattr__(self, "kappa", float(self.kappa))

    @classmethod
    def centred(cls, focal: float, image_shape: tuple[int, int], kappa: float = 0.0) -> Camera:
        """Return a camera with square pixels and its principal point in the middle of the image.

        Parameters
        ----------
        focal : float
            Focal length, LR px.
        image_shape : tuple of int
            (height, width) of a frame.
        kappa : float, optional
        """
        x, y = (image_shape[1] - 1) / 2.0, (image_shape[0] - 1) / 2.0
        return cls(np.array([[focal, 0.0, x], [0.0, focal, y], [0.0, 0.0, 1.0]]), kappa)

    @property
    def fold_radius(self) -> tuple[float, float]:
        """Undistorted and distorted radius of the fold, normalised; infinite for kappa >= 0."""
        if self.kappa >= 0:
            return np.inf, np.inf
        r_u = 1.0 / float(np.sqrt(-3.0 * self.kappa))
        return r_u, 2.0 / 3.0 * r_u

    def distort(self, xy: ArrayLike) -> Array:
        """Distort normalised image coordinates (Eqs. 4 and 5).

        Parameters
        ----------
        xy : (..., 2) float64
            Undistorted normalised coordinates.

        Returns
        -------
        (..., 2) float64
            Distorted coordinates, NaN beyond the fold.
        """
        xy = np.asarray(xy, dtype=np.float64)
        if self.kappa == 0:
            return xy.copy()
        return _scaled(xy, self._stretch(_squared_radius(xy)))

    def undistort(self, xy: ArrayLike) -> Array:
        """Undistort normalised image coordinates, the inverse of `distort` (App. A).

        Parameters
        ----------
        xy : (..., 2) float64
            Distorted normalised coordinates.

        Returns
        -------
        (..., 2) float64
            Undistorted coordinates, NaN beyond the fold r_d^2 > -4 / (27 kappa).

        Notes
        -----
        Cardano's solution in its trigonometric form. With s = r_d sqrt(27 |kappa| / 4),

            r_u / r_d = 3 sinh(asinh(s) / 3) / s    for kappa > 0,
            r_u / r_d = 3 sin(asin(s) / 3) / s      for kappa < 0, s <= 1,

        which never subtracts like from like, so it is good to a few ulp for any small kappa. For
        kappa < 0 it is the root z_3 of Eq. 12, the one that is continuous at kappa = 0. Near the
        fold the inverse itself is ill-conditioned, d r_u / d r_d = 1 / (1 + 3 kappa r_u^2).
        """
        xy = np.asarray(xy, dtype=np.float64)
        if self.kappa == 0:
            return xy.copy()
        s = np.sqrt(_squared_radius(xy)) * np.sqrt(6.75 * abs(self.kappa))
        # There the ratio is 1 to the last bit, long before s underflows.
        s = np.where(s < 1e-12, 1e-12, s)
        if self.kappa > 0:
            root = np.sinh(np.arcsinh(s) / 3.0)
        else:
            s = np.where(s > 1.0 + _FOLD_SLACK, np.nan, np.minimum(s, 1.0))
            root = np.sin(np.arcsin(s) / 3.0)
        return _scaled(xy, 3.0 * root / s)

    def project(self, H: Array, module_points: ArrayLike) -> Array:
        """Pixels of points in the module plane, the motion m_i (Eqs. 2 and 3).

        Parameters
        ----------
        H : (3, 3) float64
            Module plane to normalised image coordinates.
        module_points : (..., 2) float64
            Points (x, y), module units.

        Returns
        -------
        (..., 2) float64
            Pixels (x, y), NaN behind the camera and beyond the fold.
        """
        return self.to_pixels(self.distort(_apply(H, module_points)))

    def unproject(self, H: Array, px: ArrayLike) -> Array:
        """Points of the module plane under pixels, the inverse motion.

        Parameters
        ----------
        H : (3, 3) float64
            Module plane to normalised image coordinates.
        px : (..., 2) float64
            Pixels (x, y).

        Returns
        -------
        (..., 2) float64
            Points (x, y), module units; NaN beyond the fold and beyond the horizon.
        """
        return _apply(np.linalg.inv(H), self.undistort(self.to_normalised(px)))

    def jacobian(self, H: Array, module_points: ArrayLike) -> Array:
        """Return d px / d module point: (n, 2, 2) for (n, 2) points, NaN where `project` is."""
        return self.derivatives(H, module_points).d_module

    def derivatives(self, H: Array, module_points: ArrayLike) -> ProjectionDerivatives:
        """Project (n, 2) module points with all first derivatives, analytically.

        Notes
        -----
        With u = H y / w: d d(u) / d u = (1 + kappa u^T u) I + 2 kappa u u^T and
        d u / d y = (H[:2, :2] - u H[2, :2]) / w.
        """
        H = np.asarray(H, dtype=np.float64)
        points = np.asarray(module_points, dtype=np.float64)
        n = len(points)
        u = _apply(H, points)
        r2 = _squared_radius(u)
        stretch = self._stretch(r2)
        # The point index runs last in memory: numpy's inner loops are then long.
        ux, uy = np.where(np.isnan(stretch), np.nan, u.T)
        w = H[2, 0] * points[:, 0] + H[2, 1] * points[:, 1] + H[2, 2]
        y = np.array([points[:, 0], points[:, 1], np.ones(n)]) / np.where(w > 0, w, np.nan)

        bend = 2.0 * self.kappa
        D = np.array(
            [[stretch + bend * ux * ux, bend * ux * uy], [bend * ux * uy, stretch + bend * uy * uy]]
        )
        A = np.einsum("ij,jkn->ikn", self.K[:2, :2], D)
        along = A[:, 0] * ux + A[:, 1] * uy

        d_homography = np.empty((2, 8, n))
        d_homography[:, 0:3] = A[:, 0, None] * y
        d_homography[:, 3:6] = A[:, 1, None] * y
        d_homography[:, 6:8] = -along[:, None] * y[:2]

        d_module = (
            A[:, 0, None] * H[0, :2, None]
            + A[:, 1, None] * H[1, :2, None]
            - along[:, None] * H[2, :2, None]
        ) * y[2]

        d_intrinsics = np.zeros((2, 4, n))
        d_intrinsics[0, 0] = ux * stretch
        d_intrinsics[1, 1] = uy * stretch
        d_intrinsics[0, 2] = d_intrinsics[1, 3] = 1.0
        d_intrinsics[:, :, np.isnan(stretch)] = np.nan
        return ProjectionDerivatives(
            px=self.to_pixels(_scaled(u, stretch)),
            d_module=d_module.transpose(2, 0, 1),
            d_homography=d_homography.transpose(2, 0, 1),
            d_kappa=(self.K[:2, :2] @ np.array([ux * r2, uy * r2])).T,
            d_intrinsics=d_intrinsics.transpose(2, 0, 1),
        )

    def to_pixels(self, xy: ArrayLike) -> Array:
        """Apply K: distorted normalised coordinates (..., 2) to pixels."""
        return _affine(self.K[:2, :2], self.K[:2, 2], xy)

    def to_normalised(self, px: ArrayLike) -> Array:
        """Apply the inverse of K: pixels (..., 2) to distorted normalised coordinates."""
        inverse = np.asarray(np.linalg.inv(self.K[:2, :2]), dtype=np.float64)
        return _affine(inverse, -inverse @ self.K[:2, 2], px)

    def _stretch(self, r2: Array) -> Array:
        """r_d / r_u for squared undistorted radii, NaN beyond the fold."""
        stretch: Array = 1.0 + self.kappa * r2
        slope = 3.0 * stretch - 2.0  # d r_d / d r_u, zero on the fold
        return np.where(slope < -_FOLD_SLACK, np.nan, stretch)


def _squared_radius(xy: Array) -> Array:
    r2: Array = xy[..., 0] ** 2 + xy[..., 1] ** 2
    return r2


def _scaled(xy: Array, factor: Array) -> Array:
    """Points (..., 2) times a factor (...) each."""
    out = np.empty(xy.shape)
    out[..., 0] = xy[..., 0] * factor
    out[..., 1] = xy[..., 1] * factor
    return out


def _affine(A: Array, shift: Array, points: ArrayLike) -> Array:
    """Return A @ point + shift for (..., 2) points."""
    points = np.asarray(points, dtype=np.float64)
    x, y = points[..., 0], points[..., 1]
    out = np.empty(points.shape)
    out[..., 0] = A[0, 0] * x + A[0, 1] * y + shift[0]
    out[..., 1] = A[1, 0] * x + A[1, 1] * y + shift[1]
    return out


def _apply(H: ArrayLike, points: ArrayLike) -> Array:
    """Homography on (..., 2) points; NaN where the third component is not positive."""
    H = np.asarray(H, dtype=np.float64)
    points = np.asarray(points, dtype=np.float64)
    x, y = points[..., 0], points[..., 1]
    w = H[2, 0] * x + H[2, 1] * y + H[2, 2]
    inverse = 1.0 / np.where(w > 0, w, np.nan)
    out = np.empty(points.shape)
    out[..., 0] = (H[0, 0] * x + H[0, 1] * y + H[0, 2]) * inverse
    out[..., 1] = (H[1, 0] * x + H[1, 1] * y + H[1, 2]) * inverse
    return out
