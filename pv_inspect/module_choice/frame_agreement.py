"""Which frames show the same module: frames are compared cell by cell and grouped by agreement.

Two modules of one make have gaps, busbars and a frame in common, but not their silicon. Frames that
agree in the details of their cells are of one module; the mean of different modules would look
sharp and show none of them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pv_inspect.calibration.calibrate import Calibration
from pv_inspect.module_choice.cell_details import CellDetails, cell_details
from pv_inspect.module_choice.detail_agreement import Pairs, compare_details
from pv_inspect.sequence.sequence import FrameSequence

__all__ = ["FrameGroups", "Placement", "group_frames"]

Array = NDArray[np.float64]

SAME_MODULE = 0.6
"""Agreement from which on frames show one module whatever its error."""
SIMILAR = 0.3
"""Agreement up to which they show different ones, if it is known well: modules of one make may have
a little in common."""
BY_CHANCE = 4.5
"""Standard errors that two modules reach by chance once in 300,000 pairs, in between."""
EXPECTED = 0.8
"""Least agreement of frames of one module; what is missing to 1 are errors of pose and noise."""
SURE = 3.5
"""Standard errors by noise by which an agreement must lie under the expected one to tell modules
apart: one pair in 4000 of one module does, if the errors are Gaussian."""
COARSE = 0.25
"""Standard error by chance from which on even frames of one module would not stand out."""
SURE_TURN = 5.0
"""Standard errors above 0 at which a frame is turned against what the detection says."""
COMPARED_GROUPS, COMPARED_FRAMES = 2, 3
"""Of so many groups and frames in each it is asked whether their grids lie beside each other."""


@dataclass(frozen=True)
class Placement:
    """How the grid of a frame comes to that of the others: moved by whole cells, then turned.

    Parameters
    ----------
    turn : int
        Quarter turns, as of `Pose.turned`.
    rows, cols : int
        By how many cells the cells of the frame are moved down and to the right.
    """

    turn: int = 0
    rows: int = 0
    cols: int = 0

    def of(self, details: CellDetails) -> CellDetails:
        """Return the cells of a frame at their places."""
        return details.shifted(self.rows, self.cols).turned(self.turn)

    def after(self, quarter_turns: int) -> Placement:
        """Return this placement for a frame that was turned before."""
        rows, cols = self.rows, self.cols
        for _ in range(quarter_turns % 4):
            rows, cols = cols, -rows
        return Placement((self.turn + quarter_turns) % 4, rows, cols)


@dataclass(frozen=True, eq=False)
class FrameGroups:
    """Frames by the module that they show.

    Parameters
    ----------
    groups : tuple of tuple of int
        Frames of every group; the largest group first.
    placements : dict of int to Placement
        What brings the cells of a frame to the place that they have in the others of its group.
    agreement : (n_groups, n_groups) float64
        Mean agreement between the frames of two groups or, on the diagonal, within one; about 1
        for the same module and 0 for different ones. NaN where there is nothing to compare.
    comparable : bool
        Whether every frame of the largest group agrees with the others by more than chance: False
        where the cells look so much alike, or are so noisy, that nothing tells modules apart.
    """

    groups: tuple[tuple[int, ...], ...]
    placements: dict[int, Placement]
    agreement: Array
    comparable: bool


def group_frames(
    sequence: FrameSequence, calibration: Calibration, frames: list[int]
) -> FrameGroups:
    """Group frames by the module that they show.

    Parameters
    ----------
    sequence : FrameSequence
    calibration : Calibration
        Poses of all these frames.
    frames : list of int

    Returns
    -------
    FrameGroups

    Notes
    -----
    Groups are merged in the order of their agreement over its standard error (average linkage),
    until the agreement of all that are left is what chance explains and significantly less than
    that of one module.
    """
    layout = calibration.layout
    details = cell_details(sequence, calibration, frames)
    turns = layout.turns
    found = _Clusters(compare_details(details, turns), turns).result(frames)
    return _with_shifted_grids(found, dict(zip(frames, details, strict=True)), turns)


def _with_shifted_grids(
    found: FrameGroups, details: dict[int, CellDetails], turns: tuple[int, ...]
) -> FrameGroups:
    """Join groups that show one module, but with the grid a line of cells beside the other's.

    Where the cells at an edge are dark, the outline of the module is taken for narrower than it is.
    """
    groups, placements = [list(group) for group in found.groups], dict(found.placements)
    kept = list(range(len(groups)))
    for a in range(min(len(groups), COMPARED_GROUPS)):
        for b in [k for k in kept if k > a and a in kept]:
            first, second = (
                [placements[i].of(details[i]) for i in groups[k][:COMPARED_FRAMES]] for k in (a, b)
            )
            move = _move_between(first, second, turns)
            if move is not None:
                placements |= {i: move.after(placements[i].turn) for i in groups[b]}
                groups[a] += groups[b]
                kept.remove(b)
    order = sorted(kept, key=lambda k: (-len(groups[k]), min(groups[k])))
    return FrameGroups(
        tuple(tuple(sorted(groups[k])) for k in order),
        placements,
        found.agreement[np.ix_(order, order)],
        found.comparable,
    )


def _move_between(
    first: list[CellDetails], second: list[CellDetails], turns: tuple[int, ...]
) -> Placement | None:
    """Find by how many cells the grid of the second frames lies off that of the first."""
    moves = [(1, 0), (-1, 0), (0, 1), (0, -1)]
    moved = [frame.shifted(*move) for move in moves for frame in second]
    if not all(frame.seen.any() for frame in moved):
        return None
    pairs = compare_details([*first, *moved], turns)
    for k, (rows, cols) in enumerate(moves):
        start = len(first) + k * len(second)
        part = (slice(None), slice(0, len(first)), slice(start, start + len(second)))
        weight = pairs.weight[part]
        if not (weight > 0).any(axis=(1, 2)).all():
            continue
        total = weight.sum(axis=(1, 2))
        agreement = (weight * pairs.agreement[part]).sum(axis=(1, 2)) / total
        variance = (weight * pairs.variance[part]).sum(axis=(1, 2)) / total
        noise = 1.0 + float(np.median(pairs.noise))
        best = int(np.argmax(agreement))
        error = noise * float(np.sqrt(variance[best]))
        if agreement[best] > max(SAME_MODULE, SURE_TURN * error):
            return Placement(turns[best], rows, cols)
    return None


class _Clusters:
    """Average linkage of frames that may be turned."""

    def __init__(self, pairs: Pairs, turns: tuple[int, ...]) -> None:
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

    def _compared(self) -> tuple[Array, Array, Array]:
        """Return agreements with their errors, (n_turns, n, n); NaN where nothing is known.

        Standard errors first by chance, for different modules, then by noise, for one module.
        """
        known = self._weight > 0
        known &= self._alive[:, None] & self._alive[None, :] & ~np.eye(len(self._alive), dtype=bool)
        weight = np.where(known, self._weight, np.nan)
        noisy = np.outer(1.0 + self._noise, 1.0 + self._noise)
        variance = self._variance / weight
        by_chance = np.sqrt(variance * noisy) + 1e-9
        return self._sum / weight, by_chance, np.sqrt(variance * (noisy - 1.0))

    def _best(self) -> tuple[int, int, int] | None:
        """Return (turn, first, second) of the clusters to merge next."""
        agreement, error, noise = self._compared()
        with np.errstate(invalid="ignore"):
            sure = agreement / error
            enough = np.clip(BY_CHANCE * error, SIMILAR, SAME_MODULE)
            same = agreement >= np.minimum(enough, EXPECTED - SURE * noise)
            same |= error > COARSE
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
        between, _, _ = self._compared()
        count = len(self._turns)
        placements: dict[int, Placement] = {}
        for k in order:
            turn = self._turn[self._members[k]] % count
            # As many frames as possible stay as they are.
            usual = int(np.bincount(turn, minlength=count).argmax())
            for member, own in zip(self._members[k], turn, strict=True):
                placements[frames[member]] = Placement(self._turns[int(own - usual) % count])
        agreement = np.full((len(order), len(order)), np.nan)
        for x, a in enumerate(order):
            for y, b in enumerate(order):
                seen = between[:, a, b]
                agreement[x, y] = np.nan if np.isnan(seen).all() else np.nanmax(seen)
            agreement[x, x] = self._within(a)
        return FrameGroups(
            tuple(tuple(sorted(frames[m] for m in self._members[k])) for k in order),
            placements,
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
