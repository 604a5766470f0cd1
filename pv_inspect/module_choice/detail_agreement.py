"""The agreement of frames in the details of their cells, and what chance would make of it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.fft import dctn

from pv_inspect.module_choice.cell_details import CellDetails, degrees_of_freedom, noise_spectrum

__all__ = ["Pairs", "compare_details"]

Array = NDArray[np.float64]

SEEN = 3.0
"""Standard errors by which a detail must be stronger than the noise to be looked at."""
MODEL_ERROR = 0.02
"""Variance that pose, blur and sampling add to a detail, as a share of the mean variance."""
LEAST_SIGNAL = 0.05
"""Share of the energy of a frame that is taken for signal at least."""
LEAST_COMMON = 3
"""Cells that two frames must have in common to be compared."""
LEAST_FREEDOM = 3
"""Cells less what they have in common; with fewer nothing is known of the chance agreement."""


@dataclass(frozen=True, eq=False)
class Pairs:
    """All pairs of n frames, the second one turned.

    Parameters
    ----------
    agreement : (n_turns, n, n) float64
        About 1 for two frames of one module, 0 for frames of different ones.
    variance : (n_turns, n, n) float64
        Of the agreement of different modules, without the part of the noise.
    weight : (n_turns, n, n) float64
        In means over pairs; 0 where nothing can be compared.
    noise : (n,) float64
        Energy of the noise of a frame over that of its signal; with noise the variance becomes
        ``variance * (1 + noise_i) * (1 + noise_j)``.
    """

    agreement: Array
    variance: Array
    weight: Array
    noise: Array


def compare_details(details: list[CellDetails], turns: tuple[int, ...]) -> Pairs:
    """Compare every frame with every other one.

    Parameters
    ----------
    details : list of CellDetails
    turns : tuple of int
        Quarter turns of the second frame that are tried.

    Returns
    -------
    Pairs

    Notes
    -----
    The agreement of frames i and j is the correlation of their whitened details c (DCT
    coefficients within the cells, without what the cells of a row or column have in common) over
    the cells that both show, corrected for the noise:
    r = sum c_i c_j / sqrt((sum c_i^2 - noise_i) (sum c_j^2 - noise_j)).
    If the modules differ, the cells of one are independent of those of the other, and r has the
    mean 0 and the variance sum_kl (c_i(k) c_j(l))^2 / (d sum c_i^2 sum c_j^2), k and l over the
    cells and d the number of free cells: all wrong pairs of cells tell what chance does.
    """
    freedom = degrees_of_freedom(*details[0].seen.shape)
    weight = _whitening(details, freedom)
    spectrum = noise_spectrum(*weight.shape)
    gain = float((np.square(weight) * spectrum).sum()) * freedom / details[0].seen.size
    turned = [_features([frame.turned(k) for frame in details], weight, gain) for k in turns]
    first, shape = turned[0], (len(turns), len(details), len(details))
    agreement, variance, weights = np.zeros(shape), np.zeros(shape), np.zeros(shape)
    cells = details[0].seen.size
    for t, second in enumerate(turned):
        common = first.seen @ second.seen.T
        energy = np.sqrt((first.energy @ second.seen.T) * (first.seen @ second.energy.T)) + 1e-30
        signal = np.sqrt((first.signal @ second.seen.T) * (first.seen @ second.signal.T)) + 1e-30
        agreement[t] = (first.values @ second.values.T) / signal
        share = np.square(common) / np.outer(first.count, second.count)
        free = np.maximum(freedom * common / cells, 1e-9)
        variance[t] = (first.second @ second.second.T) * share / free / np.square(energy)
        weights[t] = np.where(common >= LEAST_COMMON, common * np.square(signal / energy), 0.0)
    if freedom < LEAST_FREEDOM or not weight.any():
        weights[:] = 0.0
    noise = first.energy.sum(axis=1) / np.maximum(first.signal.sum(axis=1), 1e-30) - 1.0
    return Pairs(agreement, variance, weights, np.maximum(noise, 0.0))


@dataclass(frozen=True, eq=False)
class _Features:
    """What n frames show of the cells.

    ``values`` (n, cells * details); per cell (n, cells) what is ``seen``, the ``energy`` with noise
    and the ``signal`` without; ``second`` (n, details^2), the moments of the cells; ``count`` (n,)
    of cells.
    """

    values: Array
    seen: Array
    energy: Array
    signal: Array
    second: Array
    count: Array


def _whitening(details: list[CellDetails], freedom: int) -> Array:
    """Weight (ny, nx) of every DCT coefficient: all count alike as far as they stand out.

    With the variance s of a coefficient and the variance v of its noise and errors, it is whitened
    by the Wiener filter s / (s + v), squared: s^(3/2) / (s + v)^2.
    """
    share = freedom / details[0].seen.size
    count = [max(float(frame.seen.sum()), 1.0) for frame in details]
    noise = np.array([frame.noise.sum() / n for frame, n in zip(details, count, strict=True)])
    energies = [
        np.square(_coefficients(frame)).sum(axis=(0, 1)) / (n * max(share, 1e-9))
        for frame, n in zip(details, count, strict=True)
    ]
    spectrum = noise_spectrum(*energies[0].shape)
    excess = np.array(energies) - noise[:, None, None] * spectrum
    # A variance out of d free values in each of n frames has a relative error of sqrt(2 / (d n)).
    chance = np.sqrt(2.0 / (max(freedom, 1) * len(details))) * float(np.median(noise)) * spectrum
    signal = np.median(excess, axis=0)
    signal = np.where(signal > SEEN * chance, signal, 0.0)
    rest = float(np.median(noise)) * spectrum + MODEL_ERROR * float(signal.mean())
    return np.asarray(signal**1.5 / np.square(signal + rest + 1e-30))


def _features(details: list[CellDetails], weight: Array, gain: float) -> _Features:
    n = len(details)
    seen = np.array([frame.seen for frame in details], np.float64).reshape(n, -1)
    values = np.array([_coefficients(frame) * weight for frame in details])
    values = values.reshape(n, seen.shape[1], -1)
    energy = np.square(values).sum(axis=2)
    noise = gain * np.array([frame.noise for frame in details]).reshape(n, -1)
    total, left = energy.sum(axis=1), (energy - noise).sum(axis=1)
    # The noise is known on average only: every cell keeps the same share.
    share = np.maximum(left / np.maximum(total, 1e-30), LEAST_SIGNAL)
    second = np.array([(cells.T @ cells).ravel() for cells in values])
    return _Features(
        values.reshape(n, -1),
        seen,
        energy,
        energy * share[:, None],
        second,
        np.maximum(seen.sum(axis=1), 1.0),
    )


def _coefficients(frame: CellDetails) -> Array:
    return np.asarray(dctn(frame.values, axes=(2, 3), norm="ortho"))
