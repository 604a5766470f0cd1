"""How far and in which direction every frame moved while the shutter was open.

All frames show the same module. At every spatial frequency the spectra of the registered frames
are therefore one unknown spectrum F times the transfer function H_i of each frame's motion, plus
noise: F drops out, and the motions are those that explain the cross spectra best. What all frames
share, the optics above all, is part of F and does not matter.
"""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares, minimize

from pv_inspect.geometry.grid import HrGrid
from pv_inspect.registration.registration import Registration
from pv_inspect.sequence.sequence import FrameSequence

__all__ = ["CrossSpectra", "cross_spectra", "estimate_motion", "fit_motion"]

Array = NDArray[np.float64]

# Motions are told from each other: with fewer frames there is too little to compare.
_MIN_FRAMES = 4
# Frames that are compared with each other at a time; memory goes with the square.
_GROUP = 24
_MAGNIFICATION = 1.5
_PATCH_LR_PX = 64.0
_MIN_PATCHES = 4
# Band [cycles / LR px]: below, vignetting and gains differ; above, single frames are aliased.
_BAND = (0.03, 0.35)
# Up to this frequency a motion acts like a Gaussian of the same second moment.
_GAUSSIAN_BAND = 0.15
# Share of the spectrum that the model can't explain: interpolation, tilt, residual misregistration.
_MODEL_ERROR = 0.02
# Expected length [LR px]. A motion that is common to all frames is hardly seen: as far as the
# spectra leave it open it is taken for none.
_TYPICAL_LENGTH = 3.0
_COMMON_RIDGE = 0.03
_MAX_LENGTH = 10.0
# Shorter motions are a second moment like that of the optics, and noise and misregistration
# pretend up to 0.7 LR px; the reconstruction gains nothing from knowing them.
_MIN_LENGTH = 0.9
# Improvement of twice the log likelihood, by patch and frequency, that a motion must bring.
_MIN_GAIN = 50.0
_SWEEPS = 3


@dataclass(frozen=True, eq=False)
class CrossSpectra:
    """Mean cross spectra of registered frames over patches of the module plane.

    Parameters
    ----------
    power : (n_frequencies, n_frames, n_frames) float64
        Real part of ``G_i conj(G_j)``.
    frequencies : (n_frames, n_frequencies, 2) float64
        (x, y) in the sensor plane of the frame, cycles / LR px.
    n_patches : int
        Patches that were averaged.
    """

    power: Array
    frequencies: Array
    n_patches: int


def estimate_motion(sequence: FrameSequence, registration: Registration) -> Array:
    """Estimate the motion blur of every frame.

    Parameters
    ----------
    sequence : FrameSequence
    registration : Registration

    Returns
    -------
    (n_frames, 2) float64
        Path (x, y) on the sensor during the exposure, LR px, of either sign; 0 for frames that are
        not in use or whose motion is not significant.
    """
    motion = np.zeros((len(registration.used), 2))
    used = np.flatnonzero(registration.used)
    n_groups = max(int(np.ceil(used.size / _GROUP)), 1)
    for group in (used[k::n_groups] for k in range(n_groups)):
        if group.size >= _MIN_FRAMES:
            # Spectra that determine no motion leave the frames still.
            with suppress(np.linalg.LinAlgError):
                spectra = cross_spectra(sequence, registration, group)
                if spectra is not None:
                    motion[group] = np.nan_to_num(fit_motion(spectra))
    return motion


def cross_spectra(
    sequence: FrameSequence, registration: Registration, frames: NDArray[np.intp]
) -> CrossSpectra | None:
    """Cross spectra of frames on the parts of the module that all of them see.

    Returns
    -------
    CrossSpectra, or None if the frames have too little of the module in common.
    """
    grid = HrGrid.covering(
        registration.layout, registration.lr_px_per_unit, _MAGNIFICATION, margin=0.1
    )
    side = round(_PATCH_LR_PX * grid.magnification)
    stack = np.stack([_rectified(sequence, registration, int(i), grid) for i in frames])
    taper = np.hanning(side + 2)[1:-1]
    window = np.outer(taper, taper).astype(np.float32)
    fy, fx = np.fft.fftfreq(side)[:, None], np.fft.rfftfreq(side)[None]
    radius = np.hypot(fy, fx) * grid.magnification
    # Of the column fx = 0 one half repeats the other.
    band = (radius > _BAND[0]) & (radius < _BAND[1]) & ~((fx == 0) & (fy <= 0))
    power = np.zeros((int(band.sum()), len(frames), len(frames)))
    n = 0
    for y in range(0, grid.shape[0] - side + 1, side // 2):
        for x in range(0, grid.shape[1] - side + 1, side // 2):
            patch = stack[:, y : y + side, x : x + side]
            if np.isfinite(patch).all():
                patch = patch - patch.mean((1, 2), keepdims=True)
                spectrum = np.fft.rfft2(patch * window)[:, band].T
                power += (spectrum[:, :, None] * spectrum[:, None, :].conj()).real
                n += 1
    if n < _MIN_PATCHES:
        return None
    centre = np.array([registration.layout.size]) / 2
    on_grid = np.column_stack([np.broadcast_to(f, band.shape)[band] for f in (fx, fy)])
    jacobians = [registration.camera.jacobian(registration.homographies[i], centre) for i in frames]
    # x_sensor = A x_grid, hence f_grid . A^-1 m = (A^-T f_grid) . m.
    frequencies = [on_grid @ np.linalg.inv(j[0] / grid.pixels_per_unit) for j in jacobians]
    if not np.isfinite(frequencies).all():
        return None
    scale = n * float((window.astype(np.float64) ** 2).sum())
    return CrossSpectra(power / scale, np.array(frequencies), n)


def fit_motion(spectra: CrossSpectra) -> Array:
    """Fit the motions to cross spectra.

    Parameters
    ----------
    spectra : CrossSpectra

    Returns
    -------
    (n_frames, 2) float64
        See `estimate_motion`.

    Notes
    -----
    With ``G_i = H_i F + noise`` the best F is ``sum_i H_i G_i / sum_i H_i^2``; what is left to
    minimise is ``- sum_f w h' P h / h' h``, with P the cross spectra, ``h_i = a_i sinc(f . m_i)``,
    a gain a_i near 1, and w the inverse variance of noise and model errors. A motion that is short
    has no gradient in its direction, so that the descent alternates with a search over directions.
    """
    fit = _Fit.of(spectra)
    motions, gains = fit.descend(_start(spectra, fit.signal), np.ones(fit.n))
    for _ in range(_SWEEPS):
        if not fit.search(motions, gains):
            break
        motions, gains = fit.descend(motions, gains)
    lengths = np.hypot(*motions.T)
    gain = spectra.n_patches * fit.gain(motions, gains)
    still = (lengths < _MIN_LENGTH) | (gain < _MIN_GAIN) | (lengths > _MAX_LENGTH)
    motions[still] = 0.0
    return motions


@dataclass(frozen=True, eq=False)
class _Fit:
    """The objective of `fit_motion`; ``signal`` are the principal components of the spectra."""

    power: Array
    frequencies: Array
    weights: Array
    ridge: float
    signal: Array

    @classmethod
    def of(cls, spectra: CrossSpectra) -> _Fit:
        values, vectors = np.linalg.eigh(spectra.power)
        n = spectra.power.shape[1]
        noise = max(float(np.median(values[:, :-1])), 1e-12 * float(values.max()), 1e-30)
        weights = 1.0 / (noise + _MODEL_ERROR**2 * np.maximum(values[:, -1] / n, 0.0))
        ridge = 1.0 / (_TYPICAL_LENGTH**2 * max(spectra.n_patches, 1))
        signal = vectors[:, :, -1]
        signal = signal * np.where(signal.sum(1) < 0, -1.0, 1.0)[:, None]
        return cls(spectra.power, spectra.frequencies, weights, ridge, signal)

    @property
    def n(self) -> int:
        return int(self.power.shape[1])

    def value(self, parameters: Array) -> tuple[float, Array]:
        """Objective and its gradient; the parameters are motions and logarithms of gains."""
        n = self.n
        motions, logs = parameters[: 2 * n].reshape(n, 2), parameters[2 * n :]
        gains = np.exp(logs)
        u = np.einsum("ifk,ik->fi", self.frequencies, motions)
        s = np.sinc(u)
        small = np.abs(u) < 1e-4
        slope = np.where(
            small, -(np.pi**2) * u / 3.0, (np.cos(np.pi * u) - s) / np.where(small, 1, u)
        )
        h = gains * s
        hh = (h * h).sum(1)
        ph = (self.power @ h[:, :, None])[:, :, 0]
        q = (h * ph).sum(1) / hh
        by_h = -2.0 * (self.weights / hh)[:, None] * (ph - q[:, None] * h)
        by_motion = np.einsum("fi,ifk->ik", by_h * gains * slope, self.frequencies)
        # Only ratios of the gains count.
        mean = float(logs.mean())
        explained = float(self.weights @ q)
        total = -explained + self.ridge * float((motions**2).sum()) + 1e3 * mean**2
        gradient = np.concatenate(
            [
                (by_motion + 2.0 * self.ridge * motions).ravel(),
                (by_h * h).sum(0) + 2e3 * mean / n,
            ]
        )
        return total, gradient

    def descend(self, motions: Array, gains: Array) -> tuple[Array, Array]:
        """Return the motions and gains of the nearest minimum."""
        start = np.concatenate([motions.ravel(), np.log(gains)])
        found = minimize(self.value, start, jac=True, method="L-BFGS-B", options={"maxiter": 300}).x
        return found[: 2 * self.n].reshape(self.n, 2), np.exp(found[2 * self.n :])

    def search(self, motions: Array, gains: Array) -> bool:
        """Try all lengths and directions frame by frame; True if a motion was replaced."""
        angles = np.deg2rad(np.arange(0.0, 180.0, 15.0))
        lengths = np.arange(0.4, 6.1, 0.4)
        paths = lengths[:, None, None] * np.stack([np.cos(angles), np.sin(angles)], axis=-1)
        candidates = np.concatenate([np.full((1, 2), 0.05), paths.reshape(-1, 2)])
        h = gains * np.sinc(np.einsum("ifk,ik->fi", self.frequencies, motions))
        replaced = False
        for i in range(self.n):
            others = np.delete(h, i, axis=1)
            rows = np.delete(self.power, i, axis=1)
            cross = (rows[:, :, i] * others).sum(1)
            among = np.einsum("fj,fjk,fk->f", others, np.delete(rows, i, axis=2), others)
            tried = np.vstack([motions[i], candidates])
            own = gains[i] * np.sinc(tried @ self.frequencies[i].T)
            explained = among + own * (2.0 * cross + own * self.power[:, i, i])
            explained /= (others**2).sum(1) + own**2
            value = self.ridge * (tried**2).sum(1) - explained @ self.weights
            best = int(np.argmin(value))
            if best > 0:
                replaced = True
                motions[i] = tried[best]
                h[:, i] = own[best]
        return replaced

    def gain(self, motions: Array, gains: Array) -> Array:
        """How much worse the objective is with one frame still, for every frame."""
        logs = np.log(gains)
        here = self.value(np.concatenate([motions.ravel(), logs]))[0]
        gain = np.empty(self.n)
        for i in range(self.n):
            still = motions.copy()
            still[i] = 0.0
            gain[i] = self.value(np.concatenate([still.ravel(), logs]))[0] - here
        return gain


def _start(spectra: CrossSpectra, signal: Array) -> Array:
    """First motions from the curvature of the transfer functions at low frequencies.

    Notes
    -----
    There ``log H_i = -2 pi^2 f' C_i f`` with ``C_i = m_i m_i' / 12``. The principal components of
    the cross spectra give C_i less an unknown B that is common to all frames; since the C_i have
    rank one, B is what makes the smaller eigenvalues of all C_i vanish.
    """
    low = np.hypot(*np.moveaxis(spectra.frequencies.mean(0), -1, 0)) < _GAUSSIAN_BAND
    low &= (signal > 0.02).all(1)
    n = signal.shape[1]
    if low.sum() < 12:
        return np.full((n, 2), 0.2)
    logs = np.log(signal[low])
    logs -= logs.mean(1, keepdims=True)
    relative = np.empty((n, 3))
    for i in range(n):
        x, y = spectra.frequencies[i][low].T
        design = np.column_stack([np.ones(len(x)), x * x, y * y, 2 * x * y])
        relative[i] = np.linalg.lstsq(design, logs[:, i])[0][1:] / (-2.0 * np.pi**2)

    def residual(common: Array) -> Array:
        xx, yy, xy = (relative + common).T
        smaller = (xx + yy) / 2 - np.hypot((xx - yy) / 2, xy)
        ridge = np.sqrt(n) * _COMMON_RIDGE * common * [1.0, 1.0, np.sqrt(2.0)]
        return np.concatenate([smaller, ridge])

    first = np.array([-relative[:, 0].min(), -relative[:, 1].min(), 0.0])
    common = least_squares(residual, first, loss="soft_l1", f_scale=0.05).x
    motions = np.empty((n, 2))
    for i, (xx, yy, xy) in enumerate(relative + common):
        values, vectors = np.linalg.eigh(np.array([[xx, xy], [xy, yy]]))
        length = np.sqrt(12.0 * np.clip(values[1], 0.003, _MAX_LENGTH**2 / 12.0))
        motions[i] = length * vectors[:, 1]
    return motions


def _rectified(
    sequence: FrameSequence, registration: Registration, frame: int, grid: HrGrid
) -> NDArray[np.float32]:
    """One frame on the module plane, in the module's intensities; NaN where it sees nothing."""
    step = 8
    height, width = grid.shape
    y, x = np.mgrid[: height // step + 2, : width // step + 2].astype(np.float64) * step
    px = registration.camera.project(
        registration.homographies[frame], grid.to_module(np.stack([x, y], axis=-1))
    )
    coarse = np.nan_to_num(px, nan=-1e4).astype(np.float32)
    # The mapping is smooth: every eighth pixel says it to 0.01 px.
    enlarge = np.array([[1.0 / step, 0.0, 0.0], [0.0, 1.0 / step, 0.0]])
    places = cv2.warpAffine(
        coarse, enlarge, (width, height), flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    )
    ready = sequence.frame(frame)
    image = np.where(ready.valid, ready.image, cv2.medianBlur(ready.image, 5))
    g = (image - registration.offset[frame]) / registration.gain[frame]
    rectified = cv2.remap(
        g.astype(np.float32),
        places[..., 0],
        places[..., 1],
        cv2.INTER_LANCZOS4,
        borderMode=cv2.BORDER_CONSTANT,
        borderValue=float("nan"),
    )
    return np.asarray(rectified, np.float32)
