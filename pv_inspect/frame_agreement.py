"""Which frames show the same module: frames are compared cell by cell and grouped by agreement.

Two modules of one make have gaps, busbars and a frame in common, but not their silicon. Frames that
agree in the details of their cells are of one module; the mean of different modules would look
sharp and show none of them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.fft import dctn

from pv_inspect.calibration import Calibration
from pv_inspect.cell_details import CellDetails, cell_details, degrees_of_freedom, noise_spectrum
from pv_inspect.layout import ModuleLayout
from pv_inspect.sequence import Sequence

__all__ = ["FrameGroups", "group_frames"]

Array = NDArray[np.float64]

SAME_MODULE = 0.5
"""Agreement from which on frames show one module whatever its error."""
SIMILAR = 0.3
"""Agreement up to which they show different ones, if it is known well: modules of one make may have
a little in common."""
BY_CHANCE = 4.5
"""Standard errors that two modules reach by chance once in 300,000 pairs, in between."""
EXPECTED = 0.8
"""Least agreement of frames of one module; what is missing to 1 are errors of pose and noise."""
SURE = 3.5
"""Standard errors by which an agreement must lie under the expected one to tell modules apart: one
pair in 4000 of one module does, if the errors are Gaussian."""
SURE_TURN = 5.0
"""Standard errors above 0 at which a frame is turned against what the detection says."""
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
class FrameGroups:
    """Frames by the module that they show.

    Parameters
    ----------
    groups : tuple of tuple of int
        Frames of every group; the largest group first.
    turns : dict of int to int
        Quarter turns that bring a frame to the same way up as the others of its group.
    agreement : (n_groups, n_groups) float64
        Mean agreement between the frames of two groups or, on the diagonal, within one; about 1
        for the same module and 0 for different ones. NaN where there is nothing to compare.
    comparable : bool
        Whether every frame of the largest group agrees with the others by more than chance: False
        where the cells look so much alike, or are so noisy, that nothing tells modules apart.
    """

    groups: tuple[tuple[int, ...], ...]
    turns: dict[int, int]
    agreement: Array
    comparable: bool


def group_frames(sequence: Sequence, calibration: Calibration, frames: list[int]) -> FrameGroups:
    """Group frames by the module that they show.

    Parameters
    ----------
    sequence : Sequence
    calibration : Calibration
        Poses of all these frames.
    frames : list of int

    Returns
    -------
    FrameGroups

    Notes
    -----
    The agreement of frames i and j is the correlation of their whitened details c (DCT
    coefficients within the cells, without what the cells of a row or column have in common) over
    the cells that both show, corrected for the noise:
    r = sum c_i c_j / sqrt((sum c_i^2 - noise_i) (sum c_j^2 - noise_j)).
    If the modules differ, the cells of one are independent of those of the other, and r has the
    mean 0 and the variance sum_kl (c_i(k) c_j(l))^2 / (d sum c_i^2 sum c_j^2), k and l over the
    cells and d the number of free cells: all wrong pairs of cells tell what chance does. Groups
    are merged in the order of r over its standard error (average linkage), until the
    agreement of all that are left is what chance explains and significantly less than that of one
    module.
    """
    layout = calibration.layout
    details = cell_details(sequence, calibration, frames)
    turns = _possible_turns(layout)
    pairs = _pairs(details, turns, degrees_of_freedom(layout.rows, layout.cols))
    return _Clusters(pairs, turns).result(frames)


@dataclass(frozen=True, eq=False)
class _Pairs:
    """All pairs of frames (n_turns, n, n), the second one turned.

    ``agreement``; ``variance`` by chance, without the noise; ``weight`` in means, 0 where nothing
    can be compared; ``noise`` (n,), the noise of a frame over its signal, as energies.
    """

    agreement: Array
    variance: Array
    weight: Array
    noise: Array


def _possible_turns(layout: ModuleLayout) -> tuple[int, ...]:
    square = layout.rows == layout.cols and layout.cell_aspect == 1.0
    return (0, 1, 2, 3) if square else (0, 2)


def _pairs(details: list[CellDetails], turns: tuple[int, ...], freedom: int) -> _Pairs:
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
    return _Pairs(agreement, variance, weights, np.maximum(noise, 0.0))


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


class _Clusters:
    """Average linkage of frames that may be turned."""

    def __init__(self, pairs: _Pairs, turns: tuple[int, ...]) -> None:
        n = len(pairs.noise)
        self._turns = turns
        self._pairs = pairs
        self._members = [[k] for k in range(n)]
        self._turn = np.zeros(n, int)
        self._weight = pairs.weight.copy()
        self._sum = pairs.weight * pairs.agreement
        self._variance = pairs.weight * pairs.variance
        self._noise = pairs.noise.copy()
        self._alive = np.ones(n, bool)
        while (best := self._best()) is not None:
            self._merge(*best)
        self._take_in_the_rest()

    def _compared(self) -> tuple[Array, Array]:
        """Agreement and its standard error by chance, (n_turns, n, n); NaN if unknown."""
        known = self._weight > 0
        known &= self._alive[:, None] & self._alive[None, :] & ~np.eye(len(self._alive), dtype=bool)
        weight = np.where(known, self._weight, np.nan)
        noisy = np.outer(1.0 + self._noise, 1.0 + self._noise)
        return self._sum / weight, np.sqrt(self._variance / weight * noisy) + 1e-9

    def _best(self) -> tuple[int, int, int] | None:
        """Return (turn, first, second) of the clusters to merge next."""
        agreement, error = self._compared()
        with np.errstate(invalid="ignore"):
            sure = agreement / error
            enough = np.clip(BY_CHANCE * error, SIMILAR, SAME_MODULE)
            same = agreement >= np.minimum(enough, EXPECTED - SURE * error)
            same[1:] &= (agreement[1:] >= SAME_MODULE) & (sure[1:] > SURE_TURN)
        candidates = np.where(same, sure, -np.inf)
        turn, a, b = np.unravel_index(int(np.argmax(candidates)), candidates.shape)
        if not np.isfinite(candidates[turn, a, b]):
            return None
        return int(turn), int(a), int(b)

    def _merge(self, turn: int, a: int, b: int) -> None:
        """Take cluster b into a, turned."""
        count = len(self._turns)
        na, nb = len(self._members[a]), len(self._members[b])
        for sums in (self._weight, self._sum, self._variance):
            for t in range(count):
                sums[t, a] += sums[(t - turn) % count, b]
            for t in range(count):
                sums[t, :, a] = sums[-t % count, a]
        self._noise[a] = (na**2 * self._noise[a] + nb**2 * self._noise[b]) / (na + nb) ** 2
        self._turn[self._members[b]] += turn
        self._members[a] += self._members[b]
        self._members[b] = []
        self._alive[b] = False

    def _take_in_the_rest(self) -> None:
        """Join to the largest cluster what can't be compared with it."""
        largest = max(np.flatnonzero(self._alive), key=lambda k: len(self._members[k]))
        for other in np.flatnonzero(self._alive):
            if other != largest and not (self._weight[:, largest, other] > 0).any():
                self._merge(0, int(largest), int(other))

    def result(self, frames: list[int]) -> FrameGroups:
        """Name the clusters by the numbers of the frames."""
        alive = [int(k) for k in np.flatnonzero(self._alive)]
        order = sorted(alive, key=lambda k: (-len(self._members[k]), min(self._members[k])))
        between, _ = self._compared()
        count = len(self._turns)
        turns: dict[int, int] = {}
        for k in order:
            turn = self._turn[self._members[k]] % count
            # As many frames as possible stay as they are.
            usual = int(np.bincount(turn, minlength=count).argmax())
            for member, own in zip(self._members[k], turn, strict=True):
                turns[frames[member]] = self._turns[int(own - usual) % count]
        agreement = np.full((len(order), len(order)), np.nan)
        for x, a in enumerate(order):
            for y, b in enumerate(order):
                seen = between[:, a, b]
                agreement[x, y] = np.nan if np.isnan(seen).all() else np.nanmax(seen)
            agreement[x, x] = self._within(a)
        return FrameGroups(
            tuple(tuple(sorted(frames[m] for m in self._members[k])) for k in order),
            turns,
            agreement,
            self._comparable(order[0]),
        )

    def _within(self, cluster: int) -> float:
        """Mean agreement of the frames of one cluster; NaN for a single frame."""
        total = weight = 0.0
        for i in self._members[cluster]:
            for j in self._members[cluster]:
                t = int(self._turn[j] - self._turn[i]) % len(self._turns)
                if i != j:
                    weight += float(self._pairs.weight[t, i, j])
                    total += float(self._pairs.weight[t, i, j] * self._pairs.agreement[t, i, j])
        return total / weight if weight > 0 else float("nan")

    def _comparable(self, cluster: int) -> bool:
        """Whether every frame of a cluster agrees with the others by more than chance."""
        members = self._members[cluster]
        if len(self._pairs.noise) < 2:
            return True
        if len(members) < 2:
            members = list(range(len(self._pairs.noise)))
            return bool((self._pairs.weight[:, members, cluster] > 0).any())
        noise = self._pairs.noise[members]
        turn = (self._turn[members][None] - self._turn[members][:, None]) % len(self._turns)
        pick = (turn, np.array(members)[:, None], np.array(members)[None])
        weight = self._pairs.weight[pick] * ~np.eye(len(members), dtype=bool)
        total = weight.sum(axis=1)
        if not (total > 0).all():
            return False
        agreement = (weight * self._pairs.agreement[pick]).sum(axis=1) / total
        variance = (weight * self._pairs.variance[pick]).sum(axis=1) / total
        others = (noise.sum() - noise) / (len(members) - 1) ** 2
        error = np.sqrt(variance * (1.0 + noise) * (1.0 + others))
        return bool((agreement > BY_CHANCE * error).all())
