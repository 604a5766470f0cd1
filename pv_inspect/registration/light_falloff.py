"""How the light falls off towards the corners, where frames show different parts of the module.

Frames that all show the whole module share the fall-off: their mean takes it up, and so do their
gains. If a border cuts some of them, each sees its part at another place of the sensor, and a gain
and an offset per frame can't make up for it: the module's mean gets seams, the poses errors.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from pv_inspect.common.robust import MAD_TO_SIGMA
from pv_inspect.geometry.camera import Camera
from pv_inspect.geometry.grid import HrGrid
from pv_inspect.registration.alignment import accumulate_frame
from pv_inspect.registration.registration import Registration, normalised
from pv_inspect.sequence.frame import Frame
from pv_inspect.sequence.sequence import FrameSequence

__all__ = ["EvenFrames", "Falloff", "evenly_lit", "falloff_of_parts"]

Array = NDArray[np.float64]

LEAST_CUT = 0.05
"""Share of the crossing points that are outside of a frame which shows a part of the module. The
frames of the sequences D1 to D6 show all; 10 to 45 % are cut in `benchmarks/frames_that_cut.py`."""
LEAST_FRAMES = 3
BLOCK_PX = 8
"""Side of the blocks of the module that are compared, LR px."""
DARK = 0.3
"""Blocks darker than this share of the usual one are left out: what is added counts there."""
ROUNDS = 3
HUBER = 2.5
SPREAD_OF_FALL, SPREAD_OF_GAIN, SPREAD_OF_OFFSET = 0.5, 0.3, 0.05
"""Standard deviations that are expected, so that what frames don't tell stays where it is: of the
coefficients of log V, of log gain and of an offset as a share of the usual light."""
LARGEST_ERROR, LARGEST_FALL = 0.1, 1.5
"""The fall-off at the corner must be known to this much and be no more than that, as in
`pv_inspect.photometry.vignetting`."""
SIGNIFICANCE = 3.0


@dataclass(frozen=True)
class Falloff:
    """Relative illumination V of the sensor, and the gains that go with it.

    Parameters
    ----------
    coefficients, deviations : tuple of float
        ``log V = a_1 q + a_2 q^2``, q = squared distance from the principal point over the squared
        half diagonal, and their standard deviations.
    gain, offset : (n_frames,) float64
        Of the frames divided by V.
    """

    coefficients: tuple[float, ...]
    deviations: tuple[float, ...]
    gain: Array
    offset: Array

    def illumination(self, camera: Camera, shape: tuple[int, int]) -> Array:
        """V at every pixel of a sensor, (height, width) float64."""
        y, x = np.mgrid[: shape[0], : shape[1]].astype(np.float64)
        q = squared_distance(np.stack([x, y], axis=-1), camera, shape)
        return np.asarray(_light(q, np.array(self.coefficients)), np.float64)

    def corrected(self, state: Registration) -> Registration:
        """Return a registration with these gains and offsets."""
        return normalised(state, state.homographies, self.gain, self.offset, state.rms)


@dataclass(frozen=True, eq=False)
class EvenFrames:
    """A sequence whose frames are divided by the relative illumination.

    Parameters
    ----------
    sequence : FrameSequence
    illumination : (height, width) float32
    """

    sequence: FrameSequence
    illumination: NDArray[np.float32]

    def __getattr__(self, name: str) -> Any:
        return getattr(self.sequence, name)

    def __len__(self) -> int:
        return len(self.sequence)

    def frame(self, index: int) -> Frame:
        """Return one frame, evenly lit."""
        frame = self.sequence.frame(index)
        added = frame.added_variance
        return replace(
            frame,
            image=frame.image / self.illumination,
            added_variance=None
            if added is None
            else (added / np.square(self.illumination)).astype(np.float32),
        )

    def as_sequence(self) -> FrameSequence:
        """Return this as what the registration expects."""
        return cast("FrameSequence", self)


def evenly_lit(sequence: FrameSequence, state: Registration) -> tuple[FrameSequence, Registration]:
    """Return frames without the fall-off and the gains that go with them, where it is told.

    Parameters
    ----------
    sequence : FrameSequence
    state : Registration
    """
    falloff = falloff_of_parts(sequence, state)
    if falloff is None:
        return sequence, state
    light = falloff.illumination(state.camera, sequence.shape).astype(np.float32)
    return EvenFrames(sequence, light).as_sequence(), falloff.corrected(state)


def squared_distance(px: Array, camera: Camera, shape: tuple[int, int]) -> Array:
    """Squared distance from the principal point over the squared half diagonal of a sensor."""
    half = 0.25 * (shape[0] ** 2 + shape[1] ** 2)
    return np.asarray(np.square(px - camera.K[:2, 2]).sum(axis=-1) / half, np.float64)


def falloff_of_parts(sequence: FrameSequence, state: Registration) -> Falloff | None:
    """Tell the fall-off from frames that show different parts of the module.

    Parameters
    ----------
    sequence : FrameSequence
    state : Registration

    Returns
    -------
    Falloff or None
        None if the frames show the same, or don't tell the fall-off.

    Notes
    -----
    Block k of the module has the brightness F_k, frame i sees it as
    ``gain_i V(q_ik) F_k + offset_i``. Gauss-Newton on the logarithms of gains and V and on the
    offsets; the F_k are eliminated.
    """
    used = np.flatnonzero(state.used)
    if used.size < LEAST_FRAMES or not _shows_parts(sequence.shape, state, used):
        return None
    seen, q = _blocks(sequence, state, used)
    for terms in (2, 1):
        fit = _fitted(seen, q, state.gain[used], state.offset[used], terms)
        if fit is None:
            continue
        coefficients, deviations, gain, offset = fit
        sure = abs(coefficients[-1]) > SIGNIFICANCE * deviations[-1]
        possible = 0.0 <= -float(coefficients.sum()) <= LARGEST_FALL
        if sure and possible and deviations.max() < LARGEST_ERROR:
            gains, offsets = state.gain.copy(), state.offset.copy()
            gains[used], offsets[used] = gain, offset
            return Falloff(tuple(coefficients.tolist()), tuple(deviations.tolist()), gains, offsets)
    return None


def _shows_parts(shape: tuple[int, int], state: Registration, used: NDArray[np.intp]) -> bool:
    end = np.array([shape[1], shape[0]]) - 1
    for index in used:
        px = np.nan_to_num(state.crossings_px(int(index)), nan=-1.0)
        if np.mean(np.any((px < 0) | (px > end), axis=1)) > LEAST_CUT:
            return True
    return False


def _blocks(
    sequence: FrameSequence, state: Registration, used: NDArray[np.intp]
) -> tuple[Array, Array]:
    """Mean of every block in every frame, NaN where it is not seen, and q in its middle."""
    camera = state.camera
    grid = HrGrid.covering(state.layout, state.lr_px_per_unit, 1.0, 0.0)
    n_y, n_x = (max(n // BLOCK_PX, 1) for n in grid.shape)
    y, x = ((np.arange(n) + 0.5) * BLOCK_PX - 0.5 for n in (n_y, n_x))
    centres = grid.to_module(np.stack(np.meshgrid(x, y), axis=-1)).reshape(-1, 2)
    seen, q = np.full((used.size, n_y * n_x), np.nan), np.full((used.size, n_y * n_x), np.nan)
    for k, index in enumerate(used):
        frame, H = sequence.frame(int(index)), state.homographies[index]
        total, weight = (np.zeros(grid.shape, np.float32) for _ in range(2))
        accumulate_frame(
            total, weight, frame.image, frame.valid, H @ grid.matrix, camera.K, camera.kappa, 1, 0
        )
        value = np.where(weight > 0, total, np.nan)[: n_y * BLOCK_PX, : n_x * BLOCK_PX]
        whole = np.full((n_y * BLOCK_PX, n_x * BLOCK_PX), np.nan)
        whole[: value.shape[0], : value.shape[1]] = value
        seen[k] = whole.reshape(n_y, BLOCK_PX, n_x, BLOCK_PX).mean(axis=(1, 3)).ravel()
        q[k] = squared_distance(camera.project(H, centres), camera, sequence.shape)
    return seen, q


def _light(q: Array, coefficients: Array) -> Array:
    powers = q[..., None] ** np.arange(1, len(coefficients) + 1)
    return np.asarray(np.exp(powers @ coefficients), np.float64)


def _fitted(
    seen: Array, q: Array, gain: Array, offset: Array, terms: int
) -> tuple[Array, Array, Array, Array] | None:
    """Coefficients of log V, their deviations, gains and offsets; None if nothing is seen twice."""
    n = len(seen)
    shown = np.isfinite(seen) & np.isfinite(q)
    shown &= shown.sum(axis=0) > 1
    if not shown.any():
        return None
    seen, q = np.where(shown, seen, 0.0), np.where(shown, q, 0.0)
    coefficients, deviations = np.zeros(terms), np.full(terms, np.inf)
    for _ in range(ROUNDS):
        scale = gain[:, None] * _light(q, coefficients)
        flat = np.where(shown, (seen - offset[:, None]) / scale, 0.0)
        module = flat.sum(axis=0) / np.maximum(shown.sum(axis=0), 1)
        usual = float(np.median(module[shown.any(axis=0)]))
        lit = shown & (module > DARK * usual)
        if not usual > 0.0 or not lit.any():
            return None
        safe = np.where(module > DARK * usual, module, 1.0)
        residual = np.where(lit, flat / safe - 1.0, 0.0)
        spread = MAD_TO_SIGMA * float(np.median(np.abs(residual[lit]))) + 1e-12
        huber = np.minimum(1.0, HUBER * spread / np.maximum(np.abs(residual), 1e-12))
        weight = np.where(lit, np.square(safe / usual * scale) * huber, 0.0)
        inverse = np.where(lit, usual / (safe * scale), 0.0)
        powers = q[None] ** np.arange(1, terms + 1)[:, None, None]
        normal, right = _equations(weight, residual, inverse, powers)
        misfit = float((weight * np.square(residual)).sum() / max(lit.sum(), 1))
        expected = np.repeat([SPREAD_OF_FALL, SPREAD_OF_GAIN, SPREAD_OF_OFFSET], [terms, n, n])
        inverted = np.linalg.inv(normal + np.diag(misfit / expected**2))
        step = inverted @ right
        coefficients = coefficients + step[:terms]
        gain = gain * np.exp(step[terms : terms + n])
        offset = offset + step[terms + n :] * usual
        deviations = np.sqrt(misfit * np.diag(inverted)[:terms])
    return coefficients, deviations, gain, offset


def _equations(
    weight: Array, residual: Array, inverse: Array, powers: Array
) -> tuple[Array, Array]:
    """Normal equations for coefficients, log gains and offsets, the blocks' light eliminated.

    Parameters
    ----------
    weight, residual, inverse : (n_frames, n_blocks) float64
        ``inverse`` is what an offset adds to the relative residual.
    powers : (n_terms, n_frames, n_blocks) float64
    """
    n, terms = len(weight), len(powers)
    total = np.maximum(weight.sum(axis=0), 1e-12)
    left = residual - (weight * residual).sum(axis=0) / total
    basis = powers - (weight * powers).sum(axis=1)[:, None] / total
    # Columns of gains and offsets: one frame each, less the mean over the frames.
    gains, offsets = weight, weight * inverse
    normal = np.zeros((terms + 2 * n, terms + 2 * n))
    normal[:terms, :terms] = np.einsum("ik,aik,bik->ab", weight, basis, basis)
    kinds = ((slice(terms, terms + n), gains), (slice(terms + n, None), offsets))
    for place, one in kinds:
        normal[place, :terms] = np.einsum("ik,aik->ia", one, basis)
        normal[:terms, place] = normal[place, :terms].T
        for other_place, other in kinds:
            both = np.divide(one * other, weight, out=np.zeros_like(weight), where=weight > 0)
            normal[place, other_place] = np.diag(both.sum(axis=1)) - (one / total) @ other.T
    right = np.concatenate(
        [
            np.einsum("ik,aik,ik->a", weight, basis, left),
            (gains * left).sum(axis=1),
            (offsets * left).sum(axis=1),
        ]
    )
    return normal, right
