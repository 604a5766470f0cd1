"""Robust bundle adjustment of one camera and a free homography per frame.

Sparse: the frames meet only in kappa and the centre of distortion, so each frame's 8 parameters
are eliminated by the Schur complement and the cost grows linearly with the number of frames.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from pv_inspect.calibration.normal_equations import NormalEquations
from pv_inspect.geometry.camera import Camera

__all__ = ["Bundle", "Fit", "View"]

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]

# Weak prior: without evidence there is no distortion.
KAPPA_STD = 0.3
# Cauchy loss in units of the residuals' own scale: 95 % efficient for Gaussian errors.
CAUCHY = 2.385
# Beyond this many standard deviations a point is an outlier: exp(-16 / 2) of Gaussian ones are.
OUTLIER = 4.0
# Median of the length of a 2D Gaussian vector with unit standard deviation per axis.
RAYLEIGH_MEDIAN = float(np.sqrt(2.0 * np.log(2.0)))
# Squared residual of a point without an image, in units of its variance: large, but finite, so that
# costs can still be compared.
NO_IMAGE = 1e6
MAX_STEPS = 30
# Scale of residuals without noise, units of sigma_px: keeps the covariances regular.
SMALLEST_SCALE = 1e-3


@dataclass(frozen=True, eq=False)
class View:
    """Measured points of one frame.

    Parameters
    ----------
    ids : (n,) int
        Which crossing point of the module each one is.
    points : (n, 2) float64
        Where it lies in the plane.
    px : (n, 2) float64
        Where it was measured, LR px.
    sigma_px : (n,) float64
        Standard deviation of that per axis, LR px.
    trusted : (n,) bool or None
        Points that are never outliers and say nothing about the errors of the others.
    """

    ids: NDArray[np.intp]
    points: Array
    px: Array
    sigma_px: Array
    trusted: Bools | None = None


@dataclass(frozen=True, eq=False)
class Bundle:
    """The problem: measured points, and what is fixed or known beforehand.

    Parameters
    ----------
    views : mapping of frame number to View
    focal : float
        Focal length, LR px: a gauge, it has no influence on pixels.
    centre : (float, float)
        Image centre, LR px.
    centre_std : float
        Prior standard deviation of the principal point around it, LR px; 0 fixes it.
    kappa : float or None
        Fixed distortion, None to fit it.
    pixel_shape : (2, 2) float64
        K[:2, :2] / focal: the identity for square pixels.
    known_kappa : tuple of float, optional
        Mean and standard deviation of a prior on kappa, for this focal length; about 0 and as wide
        as lenses are if not given.
    """

    views: Mapping[int, View]
    focal: float
    centre: tuple[float, float]
    centre_std: float
    kappa: float | None
    pixel_shape: Array = field(default_factory=lambda: np.eye(2))
    known_kappa: tuple[float, float] | None = None

    def without(self, frames: Collection[int]) -> Bundle:
        """Return the problem with some frames taken out."""
        return replace(self, views={i: v for i, v in self.views.items() if i not in frames})

    @property
    def free(self) -> list[int]:
        """Return which of the common parameters (kappa, cx, cy) are fitted."""
        return ([0] if self.kappa is None else []) + ([1, 2] if self.centre_std > 0 else [])

    @property
    def prior(self) -> tuple[Array, Array]:
        """Mean and weight (1 / variance) of the common parameters (kappa, cx, cy)."""
        kappa, kappa_std = self.known_kappa or (0.0, KAPPA_STD)
        weights = [kappa_std**-2, *[self.centre_std**-2 if self.centre_std > 0 else 0.0] * 2]
        return np.array([kappa, *self.centre]), np.array(weights)

    def fit(self, starts: Mapping[int, Array]) -> Fit:
        """Fit from homographies that ignore the distortion, h33 = 1, without a centre known.

        A Cauchy loss whose scale follows the residuals down finds the outliers; least squares
        over what is left gives the result.
        """
        common = np.array([self.kappa or 0.0, *self.centre])
        inliers = {i: np.ones(len(view.px), dtype=bool) for i, view in self.views.items()}
        fit = Fit(self, dict(starts), common, inliers, scale=1.0)
        scale = fit.robust_scale()
        for _ in range(12):
            fit = _adjust(replace(fit, scale=scale), robust=True)
            scale, before = fit.robust_scale(), scale
            if scale > 0.9 * before:
                break
        return replace(fit, scale=scale).with_reweighted_frames().refined()


@dataclass(frozen=True, eq=False)
class Fit:
    """A solution of a `Bundle`.

    Parameters
    ----------
    bundle : Bundle
    homographies : dict of frame number to (3, 3) float64, h33 = 1
    common : (3,) float64
        kappa, cx, cy.
    inliers : dict of frame number to (n_points,) bool
    scale : float
        Standard deviation of the residuals per axis in units of sigma_px.
    repetition : float
        In how many frames an error repeats itself: a detector may err in the same way at the same
        crossing in all frames. 1 if all errors are independent. Priors count that much more.
    """

    bundle: Bundle
    homographies: dict[int, Array]
    common: Array
    inliers: dict[int, Bools]
    scale: float
    repetition: float = 1.0

    @property
    def camera(self) -> Camera:
        """The camera of the solution."""
        kappa, *centre = self.common
        K = np.eye(3)
        K[:2, :2] = self.bundle.focal * self.bundle.pixel_shape
        K[:2, 2] = centre
        return Camera(K, kappa)

    @property
    def kappa_std(self) -> float:
        """Standard deviation of kappa from the curvature at the solution; 0 if it is fixed."""
        if self.bundle.kappa is not None:
            return 0.0
        variance = self.repetition * self.normal_equations().common_covariance()[0, 0]
        return float(np.sqrt(variance))

    def predicted_sigma_px(self, points: Array) -> dict[int, Array]:
        """Standard deviation of the places that the fit predicts for points of the plane.

        Parameters
        ----------
        points : (n, 2) float64

        Returns
        -------
        dict of frame number to (n,) float64
            Per axis (root mean square of x and y), LR px; NaN without an image.

        Notes
        -----
        With the normal equations [[A, B], [B^T, C]] and the covariance S of the common parameters,
        a pixel with the derivatives J (homography) and G (common) has the covariance
        J A^-1 J^T + (G - J A^-1 B) S (G - J A^-1 B)^T. S counts errors that repeat in all frames.
        """
        equations = self.normal_equations()
        inverse = np.linalg.pinv(equations.A, hermitian=True)
        common = self.repetition * equations.common_covariance()
        camera, sigma = self.camera, {}
        for k, (i, H) in enumerate(self.homographies.items()):
            d = camera.derivatives(H, points)
            J = d.d_homography
            G = np.concatenate([d.d_kappa[:, :, None], d.d_intrinsics[:, :, 2:]], axis=2)
            G = G[:, :, self.bundle.free] - J @ (inverse[k] @ equations.B[k])
            variance = np.sum((J @ inverse[k]) * J, axis=2) + np.sum((G @ common) * G, axis=2)
            sigma[i] = np.sqrt(np.maximum(variance.mean(axis=1), 0.0))
        return sigma

    def distances_px(self, i: int) -> Array:
        """Distance of every measured point of frame i from the model, LR px; NaN: no image."""
        view = self.bundle.views[i]
        px = self.camera.project(self.homographies[i], view.points)
        return np.asarray(np.hypot(*(view.px - px).T))

    def rms_px(self, i: int) -> float:
        """RMS distance over the inliers of frame i, LR px."""
        return float(np.sqrt(np.mean(self.distances_px(i)[self.inliers[i]] ** 2)))

    def typical_error_px(self, i: int) -> float:
        """RMS distance that a Gaussian with the median distance of frame i has, LR px."""
        distances = np.nan_to_num(self.distances_px(i), nan=np.inf)
        return float(np.sqrt(2.0) * np.median(distances) / RAYLEIGH_MEDIAN)

    def px_per_unit(self, i: int) -> float:
        """Scale of frame i at the origin of the plane, LR px per unit of the plane."""
        J = self.camera.jacobian(self.homographies[i], np.zeros((1, 2)))[0]
        return float(np.sqrt(abs(np.linalg.det(J)))) if np.isfinite(J).all() else 0.0

    def robust_scale(self) -> float:
        """Median-based scale of all residuals in units of sigma_px."""
        distances = [np.sqrt(self._squared(i)) for i in self.homographies]
        return max(float(np.median(np.concatenate(distances))) / RAYLEIGH_MEDIAN, SMALLEST_SCALE)

    def with_focal_length(self, focal: float) -> Fit:
        """Return the same solution in another gauge: no pixel moves."""
        ratio = focal / self.bundle.focal
        gauge = np.diag([1.0 / ratio, 1.0 / ratio, 1.0])
        known = self.bundle.known_kappa
        if known is not None:
            known = known[0] * ratio**2, known[1] * ratio**2
        return replace(
            self,
            bundle=replace(self.bundle, focal=focal, known_kappa=known),
            homographies={i: gauge @ H for i, H in self.homographies.items()},
            common=self.common * [ratio**2, 1.0, 1.0],
        )

    def with_reweighted_frames(self) -> Fit:
        """Return the solution with sigma_px raised in frames whose residuals are far above it."""
        views = dict(self.bundle.views)
        for i, view in views.items():
            own = float(np.median(np.sqrt(self._squared(i)))) / RAYLEIGH_MEDIAN
            if own > 2.0 * self.scale:
                views[i] = replace(view, sigma_px=view.sigma_px * (own / self.scale))
        return replace(self, bundle=replace(self.bundle, views=views))

    def with_kappa(self, kappa: float) -> Fit:
        """Return the solution with another kappa, not yet adjusted to it."""
        return replace(self, common=np.array([kappa, *self.common[1:]]))

    def refined(self) -> Fit:
        """Return the least-squares solution over the inliers, which are chosen anew."""
        fit = self
        for _ in range(5):
            limit = (OUTLIER * fit.scale) ** 2
            inliers = {i: fit._squared(i) <= limit for i in fit.homographies}
            # Every frame stays determined, also one that is rejected for its misfit later.
            inliers = {i: m if m.mean() > 0.5 else np.ones_like(m) for i, m in inliers.items()}
            for i, view in fit.bundle.views.items():
                if view.trusted is not None:
                    inliers[i] = inliers[i] | view.trusted
            same = all(np.array_equal(inliers[i], fit.inliers[i]) for i in inliers)
            fit = _adjust(replace(fit, inliers=inliers), robust=False)
            before = fit.repetition
            fit = replace(fit, scale=fit._inlier_scale())
            fit = replace(fit, repetition=fit._repetition())
            if same and abs(fit.repetition / before - 1.0) < 0.1:
                break
        return fit

    def at_kappa(self, kappa: float) -> Fit:
        """Return the least-squares solution with kappa fixed, over the same inliers."""
        bundle = replace(self.bundle, kappa=kappa)
        return _adjust(replace(self.with_kappa(kappa), bundle=bundle), robust=False)

    def cost(self, robust: bool) -> float:
        """Sum of losses and priors, in units of the residuals' variance."""
        total = 0.0
        for i in self.homographies:
            d2 = self._squared(i)[self.inliers[i]] / self.scale**2
            total += float(np.sum(CAUCHY**2 * np.log1p(d2 / CAUCHY**2) if robust else d2))
        mean, weight = self._prior()
        free = self.bundle.free
        return total + float(np.sum((weight * (self.common - mean) ** 2)[free]))

    def normal_equations(self, robust: bool = False) -> NormalEquations:
        """Gauss-Newton normal equations with iteratively re-weighted residuals."""
        free = self.bundle.free
        mean, weight = self._prior()
        n, m = len(self.homographies), len(free)
        A, a = np.empty((n, 8, 8)), np.empty((n, 8))
        B = np.empty((n, 8, m))
        C, c = np.diag(weight[free]), (weight * (mean - self.common))[free]
        camera = self.camera
        for k, (i, H) in enumerate(self.homographies.items()):
            view = self.bundle.views[i]
            d = camera.derivatives(H, view.points)
            weights = self.inliers[i] / (view.sigma_px * self.scale) ** 2
            residuals = view.px - d.px
            if robust:
                d2 = weights * np.sum(residuals**2, axis=1)
                weights = weights / (1.0 + d2 / CAUCHY**2)
            there = np.isfinite(weights) & np.isfinite(d.px[:, 0])
            w = np.repeat(np.sqrt(weights[there]), 2)
            J = d.d_homography[there].reshape(-1, 8) * w[:, None]
            d_common = np.concatenate([d.d_kappa[:, :, None], d.d_intrinsics[:, :, 2:]], axis=2)
            G = d_common[there].reshape(-1, 3)[:, free] * w[:, None]
            r = residuals[there].ravel() * w
            A[k], B[k], a[k] = J.T @ J, J.T @ G, J.T @ r
            C += G.T @ G
            c += G.T @ r
        return NormalEquations(A, B, C, a, c)

    def stepped(self, homographies: Array, common: Array) -> Fit:
        """Return the solution moved by steps (n_frames, 8) and (n_free,)."""
        moved = {
            i: H + np.append(step, 0.0).reshape(3, 3)
            for (i, H), step in zip(self.homographies.items(), homographies, strict=True)
        }
        new = self.common.copy()
        new[self.bundle.free] += common
        return replace(self, homographies=moved, common=new)

    def _prior(self) -> tuple[Array, Array]:
        mean, weight = self.bundle.prior
        return mean, self.repetition * weight

    def _repetition(self) -> float:
        """Variance of the mean residual of each crossing over the frames, independent ones = 1."""
        size = 1 + max(int(view.ids.max()) for view in self.bundle.views.values())
        total, count = np.zeros((size, 2)), np.zeros(size)
        for i, H in self.homographies.items():
            view, good = self.bundle.views[i], self._usual(i)
            residuals = (view.px - self.camera.project(H, view.points)) / view.sigma_px[:, None]
            total[view.ids[good]] += residuals[good]
            count[view.ids[good]] += 1.0
        seen = count > 0
        if not seen.any():
            return 1.0
        ratios = np.sum(total[seen] ** 2, axis=1) / (2.0 * count[seen] * self.scale**2)
        return float(np.clip(np.nan_to_num(np.mean(ratios), nan=1.0), 1.0, len(self.homographies)))

    def _squared(self, i: int) -> Array:
        """Squared residuals of frame i in units of sigma_px^2."""
        squared = (self.distances_px(i) / self.bundle.views[i].sigma_px) ** 2
        return np.where(np.isnan(squared), NO_IMAGE, squared)

    def _usual(self, i: int) -> Bools:
        """Inliers of frame i that tell how large errors usually are."""
        trusted = self.bundle.views[i].trusted
        return self.inliers[i] if trusted is None else self.inliers[i] & ~trusted

    def _inlier_scale(self) -> float:
        squared = np.concatenate([self._squared(i)[self._usual(i)] for i in self.homographies])
        freedom = 2 * len(squared) - 8 * len(self.homographies) - len(self.bundle.free)
        # Without redundancy the residuals say nothing about the errors: believe sigma_px.
        if freedom < 1:
            return max(self.scale, 1.0)
        return max(float(np.sqrt(np.sum(squared) / freedom)), SMALLEST_SCALE)


def _adjust(fit: Fit, robust: bool) -> Fit:
    """Levenberg-Marquardt; returns the best it has found, whatever happens."""
    damping, cost, new_cost = 1e-4, fit.cost(robust), np.inf
    n_points = sum(len(m) for m in fit.inliers.values())
    for _ in range(MAX_STEPS):
        equations = fit.normal_equations(robust)
        while damping < 1e8:
            try:
                step = equations.solve(damping)
            except np.linalg.LinAlgError:
                step = (np.full(1, np.nan), np.zeros(0))
            if all(np.isfinite(part).all() for part in step):
                trial = fit.stepped(*step)
                new_cost = trial.cost(robust)
                if new_cost < cost:
                    break
            damping *= 10.0
        else:
            return fit
        gain, fit, cost = cost - new_cost, trial, new_cost
        damping = max(damping / 10.0, 1e-12)
        if gain < 1e-9 * cost + 1e-12 * n_points:
            break
    return fit
