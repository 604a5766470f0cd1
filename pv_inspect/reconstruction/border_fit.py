"""What blur turns sharp borders of cells into the profiles that the frames show.

A cell is bright up to its border, a little less so close to it, where carriers recombine; a gap is
a dark line of unknown width and light, the surroundings a dark plane. All of this is shared by all
frames. Optics, motion and pixel blur it; the pixel is known.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.special import j1

from pv_inspect.reconstruction.border_profiles import BorderProfiles

__all__ = ["BorderFit", "Shape", "fit_borders"]

Array = NDArray[np.float64]
Shape = Literal["gaussian", "disc"]

# Grid that profiles are modelled on, LR px; they repeat after 18 LR px.
_STEP, _N = 1.0 / 24.0, 432
_X = (np.arange(_N) - _N / 2) * _STEP
_F = np.fft.rfftfreq(_N, _STEP)
# Parameters that all frames share: name, how many, start and expectation, its spread, step of the
# finite difference, limits. Widths and lengths in LR px at the mean scale. The spreads are what is
# known of modules; they decide nothing unless the frames leave it open.
_SHARED = (
    ("gap width", 2, 0.9, 0.5, 0.02, (0.05, 4.0)),
    ("darker rim", 2, 0.03, 0.04, 0.01, (-0.06, 0.5)),
    ("width of the rim", 2, 0.4, 0.3, 0.05, (0.1, 2.0)),
    ("light of the dark side", 4, 0.15, 0.15, 0.01, (-0.3, 0.9)),
    ("its slope", 4, 0.0, 0.05, 0.01, (-0.3, 0.3)),
    ("displaced outline", 4, 0.0, 0.1, 0.01, (-0.6, 0.6)),
)
# Second moment of optics and motion, LR px^2, and displacement of the lines, LR px, of one frame.
_MOMENT, _SHIFT = (0.25, 0.4, 0.01, (0.003, 4.0)), (0.0, 0.05, 0.01, (-0.5, 0.5))
# Second moment of the sharpest borders and of what registration leaves, LR px^2; from the training
# seeds of `benchmarks/psf_truth.py`.
_SOFTNESS = 0.008
# Relative error of the model that no number of samples averages out.
_MODEL_ERROR = 0.006
# Residuals beyond are outliers, standard deviations.
_HUBER = 3.0
_ITERATIONS = 12
_CONVERGED = 1e-3
_LEAST_SAMPLES = 3


@dataclass(frozen=True, eq=False)
class BorderFit:
    """Result of `fit_borders`.

    Parameters
    ----------
    pairs : (n,) int64
        2 * frame + axis.
    moments : (n,) float64
        Second moment along the axis of what blurs the frame, without the pixel, LR px^2.
    covariance : (n, n) float64
        Of the moments.
    shifts : (n,) float64
        Displacement of the lines, LR px.
    shared : (n_shared,) float64
        What all frames share: gaps, rims and dark sides.
    gap : float
        Width of the gap between cells, LR px.
    cost : float
        -2 log likelihood, but for a constant.
    misfit : float
        Mean squared residual in standard deviations: about 1 or below if the borders are as the
        model has them.
    """

    pairs: NDArray[np.int64]
    moments: Array
    covariance: Array
    shifts: Array
    shared: Array
    gap: float
    cost: float
    misfit: float


def fit_borders(
    profiles: BorderProfiles, shape: Shape, first: BorderFit | None = None
) -> BorderFit:
    """Fit the blur of every frame and axis with one module.

    Parameters
    ----------
    profiles : BorderProfiles
    shape : {"gaussian", "disc"}
    first : BorderFit, optional
        Of all these frames and axes and perhaps others, to start from.

    Notes
    -----
    Damped Gauss-Newton steps on Huber residuals. A parameter of one frame changes the profiles of
    this frame only, so that the parameters of all frames are differentiated at once.
    """
    model = _Model(profiles, shape)
    at = model.start.copy() if first is None else model.start_from(first)
    r = model.residual(at)
    cost, damping = model.cost(at, r), 1e-2
    normal = np.eye(len(at))
    for _ in range(_ITERATIONS):
        J = model.jacobian(at, r).reshape(-1, len(at))
        size = np.abs(r).reshape(-1)
        weight = np.where(size < _HUBER, 1.0, _HUBER / np.maximum(size, 1e-9))
        normal = J.T @ (J * weight[:, None]) + np.diag(model.spread**-2)
        slope = -J.T @ (weight * r.reshape(-1)) - (at - model.start) / model.spread**2
        before = cost
        while damping < 1e4:
            step = np.linalg.solve(normal + damping * np.diag(np.diag(normal)), slope)
            tried = np.clip(at + step, model.low, model.high)
            r_tried = model.residual(tried)
            cost_tried = model.cost(tried, r_tried)
            if cost_tried < cost:
                at, r, cost = tried, r_tried, cost_tried
                damping = max(damping / 5.0, 1e-6)
                break
            damping *= 5.0
        if before - cost < _CONVERGED * before:
            break
    n = model.n_pairs
    misfit = float((r**2).sum() / max(int((model.weight > 0).sum()), 1))
    covariance = np.asarray(np.linalg.inv(normal)[:n, :n], np.float64) * max(misfit, 1.0)
    gap = float(np.mean(at[2 * n : 2 * n + 2]))
    shifts, shared = at[n : 2 * n], at[2 * n :]
    return BorderFit(model.pairs, at[:n], covariance, shifts, shared, gap, cost, misfit)


class _Model:
    """Profiles as a function of the parameters."""

    def __init__(self, profiles: BorderProfiles, shape: Shape) -> None:
        self._p, self._shape = profiles, shape
        self.pairs, self._pair = np.unique(profiles.pair, return_inverse=True)
        self.n_pairs = len(self.pairs)
        self._axis = profiles.pair % 2
        self._kind = 2 * self._axis + profiles.outer
        self._relative = profiles.scale / float(profiles.scale.mean())
        self._rows = np.arange(len(profiles.pair))[:, None]
        enough = profiles.count >= _LEAST_SAMPLES
        self.weight = np.where(enough, 1.0 / np.sqrt(profiles.variance + _MODEL_ERROR**2), 0.0)
        # The pixel seen along the distance: boxes of its cosine and its sine.
        side = np.clip(profiles.box, 0.0, 1.0)
        other = np.sqrt(1.0 - side**2)
        self._pixel = np.sinc(side[:, None] * _F) * np.sinc(other[:, None] * _F)
        each = [_MOMENT] * self.n_pairs + [_SHIFT] * self.n_pairs
        each += [tuple(rest) for _, n, *rest in _SHARED for _ in range(n)]  # type: ignore[misc]
        self.start = np.array([e[0] for e in each])
        self.spread = np.array([e[1] for e in each])
        self._step = np.array([e[2] for e in each])
        self.low = np.array([e[3][0] for e in each])
        self.high = np.array([e[3][1] for e in each])

    def start_from(self, first: BorderFit) -> Array:
        """Parameters of a fit to more profiles."""
        known = np.searchsorted(first.pairs, self.pairs)
        return np.concatenate([first.moments[known], first.shifts[known], first.shared])

    def residual(self, at: Array) -> Array:
        """Profiles less the model, (n_profiles, BINS), in standard deviations."""
        n, p = self.n_pairs, self._p
        moment, shift = at[:n][self._pair], at[n : 2 * n][self._pair]
        split = np.cumsum([count for _, count, *_ in _SHARED])[:-1]
        gap, rim, rim_width, dark, dark_slope, outline = np.split(at[2 * n :], split)
        border = -0.5 * (gap[self._axis] * self._relative)[:, None]
        width = (rim_width[self._axis] * self._relative)[:, None]
        low, high = (np.minimum(_X + s * _STEP / 2 - border, 0.0) for s in (-1, 1))
        blur = self._pixel * self._optics(moment)
        bright = self._blurred((high - low) / _STEP, blur)
        near = self._blurred(width * (np.exp(high / width) - np.exp(low / width)) / _STEP, blur)
        where = p.distance - (shift + np.where(p.outer, outline[self._kind], 0.0))[:, None]
        rim_of = rim[self._axis][:, None]
        left, left_rim = self._at(bright, where), self._at(near, where)
        right, right_rim = self._at(bright, -where), self._at(near, -where)
        light = dark[self._kind][:, None]
        sloped = light + dark_slope[self._kind][:, None] * np.maximum(where, 0.0)
        model = p.left * (left - rim_of * left_rim)
        model += np.where(
            p.outer[:, None],
            sloped * (1.0 - left),
            p.right * (right - rim_of * right_rim) + light * (1.0 - left - right),
        )
        return np.asarray((p.value - model) * self.weight, np.float64)

    def jacobian(self, at: Array, residual: Array) -> Array:
        """Derivatives of the residual, (n_profiles, BINS, n_parameters)."""
        n = self.n_pairs
        J = np.zeros((*residual.shape, len(at)))
        for first in (0, n):
            moved = at.copy()
            moved[first : first + n] += self._step[first]
            J[self._rows[:, 0], :, first + self._pair] = (
                self.residual(moved) - residual
            ) / self._step[first]
        for k in range(2 * n, len(at)):
            moved = at.copy()
            moved[k] += self._step[k]
            J[:, :, k] = (self.residual(moved) - residual) / self._step[k]
        return J

    def cost(self, at: Array, residual: Array) -> float:
        """Sum of the Huber residuals and of the squared departures from what is expected."""
        size = np.abs(residual)
        huber = np.where(size < _HUBER, size**2, _HUBER * (2.0 * size - _HUBER))
        return float(huber.sum() + (((at - self.start) / self.spread) ** 2).sum())

    def _optics(self, moment: Array) -> Array:
        """Transfer function of the optics with a second moment per axis."""
        soft = np.exp(-2.0 * np.pi**2 * _SOFTNESS * _F**2)
        if self._shape == "gaussian":
            return np.asarray(soft * np.exp(-2.0 * np.pi**2 * moment[:, None] * _F**2))
        z = np.maximum(4.0 * np.pi * np.sqrt(moment)[:, None] * _F, 1e-9)
        return np.asarray(soft * 2.0 * j1(z) / z)

    @staticmethod
    def _blurred(scene: Array, transfer: Array) -> Array:
        return np.fft.irfft(np.fft.rfft(scene) * transfer, _N)

    def _at(self, profile: Array, x: Array) -> Array:
        place = np.clip((x - _X[0]) / _STEP, 0.0, _N - 2.001)
        k = place.astype(np.int64)
        f = place - k
        value: Array = profile[self._rows, k] * (1.0 - f) + profile[self._rows, k + 1] * f
        return value
