"""Learn the filters of the learned prior from sharp pictures of cells, and judge them.

    python benchmarks/fit_prior.py CELLS [--pictures 24]   judge those of the package on CELLS/val
    python benchmarks/fit_prior.py CELLS --fit [--steps 300]   learn on CELLS/train, then judge

CELLS holds train/ and val/, each with img/. What the prior is for is learnt with the operator that
it works with: four cells side by side on an HR grid of 3 or 4 pixels per LR pixel are blurred by
the LR pixel and optics of .3 to .65 LR px and get the white noise of 20 frames, .6 to 6 % of the
brightness each, which then is reconstructed with lambda = 1. The filters descend along the
derivative of the error at the minimiser (implicit differentiation), all noises and scales alike.

Printed are PSNR in dB of the sparse curvature and of the learned prior, each with the one lambda
that is best for all pictures and with that of every picture, by thirds of the noise.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from time import process_time

import cv2
import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from pv_inspect.common.parallel import parallel_map
from pv_inspect.reconstruction.filter_prior import (
    WEIGHTS,
    FilterGroup,
    FilterPrior,
    learned_prior,
    sparse_curvature,
)
from pv_inspect.reconstruction.prior import Prior

Array = NDArray[np.floating]
CONTRAST = 0.02
"""Of the reconstruction; the pictures have a brightness of 1."""
SIDE, MARGIN = 112, 14
"""Of a picture, and of its border that does not count, HR px."""
ROUNDS = (4, 8, 12, 12, 12, 12, 12)
"""Conjugate gradient steps on every majoriser."""
ADJOINT_STEPS = 40
FRAMES = 20
FACTOR = 1 / 8
"""Of the prior where lambda is 1 and the magnification 4; see `Problem.prior_factor`."""
FILTERS, REACH = 4, 2
BATCH = 6


@dataclass(frozen=True, eq=False)
class Picture:
    """A part of a module as frames would show it, together: blurred, with white noise."""

    truth: Array
    blur: Array
    noise: float
    frame_noise: float
    seen: Array

    def blurred(self, f: Array) -> Array:
        """Optics and LR pixel; symmetric."""
        return np.asarray(cv2.sepFilter2D(f, -1, self.blur, self.blur, borderType=0))

    def data(self, f: Array) -> Array:
        """Normal operator of the data term."""
        return self.blurred(self.blurred(f)) / self.noise**2

    @property
    def inside(self) -> tuple[slice, slice]:
        """What counts."""
        return slice(MARGIN, -MARGIN), slice(MARGIN, -MARGIN)

    def psnr(self, f: Array) -> float:
        """Of a reconstruction, dB."""
        return float(-10 * np.log10(((f - self.truth)[self.inside] ** 2).mean()))


def blur_of(magnification: int, sigma: float) -> Array:
    """One axis of the LR pixel and a Gaussian of sigma LR px, on HR pixels."""
    reach = int(np.ceil(3 * sigma * magnification + magnification / 2)) + 1
    fine = np.arange(-reach - 1, reach + 1.001, 1 / 32)
    gauss = np.exp(-0.5 * (fine / (sigma * magnification)) ** 2)
    both = np.convolve(gauss, np.abs(fine) <= magnification / 2, "same")
    taps = [both[np.abs(fine - x) <= 0.5].sum() for x in range(-reach, reach + 1)]
    return np.array(taps) / np.sum(taps)


def four_cells(files: Sequence[Path], random: np.random.Generator, side: int) -> Array:
    """Four cells with gaps between them, 1 = the median of a cell."""
    whole = np.full((2 * side, 2 * side), 0.06)
    gap = round(side * random.uniform(0.01, 0.025) / 2)
    for y in (0, side):
        for x in (0, side):
            read = cv2.imread(str(files[random.integers(len(files))]), cv2.IMREAD_GRAYSCALE)
            assert read is not None
            inner = side - 2 * gap
            cell = cv2.resize(read / 255.0, (inner, inner), interpolation=cv2.INTER_AREA)
            cell *= random.uniform(0.85, 1.15) / max(float(np.median(cell)), 0.05)
            flips = [slice(None, None, -1 if turned else 1) for turned in random.random(2) < 0.5]
            whole[y + gap : y + gap + inner, x + gap : x + gap + inner] = cell[flips[0], flips[1]]
    return whole


def picture(files: Sequence[Path], seed: int) -> Picture:
    """Draw a picture; the same for the same seed."""
    random = np.random.default_rng(seed)
    magnification = int(random.choice([3, 4]))
    side = min(int(random.uniform(45, 75) * magnification), 300)
    whole = four_cells(files, random, side)
    y, x = random.integers(0, 2 * side - SIDE, 2)
    turned = whole.T if random.random() < 0.5 else whole
    truth = np.ascontiguousarray(turned[y : y + SIDE, x : x + SIDE])
    blur = blur_of(magnification, random.uniform(0.3, 0.65))
    frame_noise = float(np.exp(random.uniform(np.log(0.006), np.log(0.06))))
    noise = frame_noise * magnification / np.sqrt(FRAMES)
    seen = cv2.sepFilter2D(truth, -1, blur, blur, borderType=cv2.BORDER_REFLECT)
    seen += noise * random.normal(size=truth.shape)
    # Single precision halves the time.
    return Picture(truth.astype(np.float32), blur, noise, frame_noise, seen.astype(np.float32))


def solved(
    apply: Callable[[Array], Array], right: Array, diagonal: Array, start: Array, steps: int
) -> Array:
    """Some steps of preconditioned conjugate gradients."""
    f, r = start, right - apply(start)
    p = z = r / diagonal
    rz = float((r * z).sum())
    for _ in range(steps):
        full = apply(p)
        curvature = float((p * full).sum())
        if curvature <= 0.0:
            break
        length = np.float32(rz / curvature)
        f, r = f + length * p, r - length * full
        z = r / diagonal
        rz, before = float((r * z).sum()), rz
        p = z + np.float32(rz / before) * p
    return f


def reconstructed(given: Picture, prior: Prior, weight: float) -> Array:
    """Minimiser of data term and prior."""
    f, right = given.seen, given.blurred(given.seen) / given.noise**2
    peak = (given.blur**2).sum() ** 2 / given.noise**2
    for steps in ROUNDS:
        bank = prior.majoriser(f, weight * FACTOR)

        def whole(v: Array, bank=bank) -> Array:  # type: ignore[no-untyped-def]
            return np.asarray(given.data(v) + bank.apply(v))

        f = solved(whole, right, peak + bank.diagonal, f, steps)
    return f


def mean(image: Array) -> Array:
    """Over the neighbourhood that shares its weights."""
    return np.asarray(cv2.blur(image, (5, 5), borderType=cv2.BORDER_CONSTANT))


def answers(image: Array, filters: Array) -> Array:
    """Correlation with every filter."""
    return np.array([cv2.filter2D(image, -1, w, borderType=0) for w in filters])


@dataclass(frozen=True, eq=False)
class Linearised:
    """Derivative of a group's gradient at an image f."""

    group: FilterGroup
    answers: Array
    root: Array
    weights: Array

    @classmethod
    def of(cls, group: FilterGroup, f: Array) -> Linearised:
        """With the answers to f, 1 / u, and the weights of the majoriser."""
        z = inner(answers(f, group.filters / CONTRAST), group.reach)
        root = 1 / np.sqrt(mean((z * z).sum(0)) + np.float32(group.smoothing**2))
        weights = inner((group.weight * FACTOR) * mean(root), group.reach)
        return cls(group, z, root, weights)

    def along(self, q: Array) -> tuple[Array, Array]:
        """Answers to an image q, and their mean product with those to f."""
        y = inner(answers(q, self.group.filters / CONTRAST), self.group.reach)
        return y, mean((self.answers * y).sum(0))

    def by_answers(self, y: Array, product: Array) -> Array:
        """Derivative of ``q' grad R(f)`` by the answers to f."""
        bend = mean(self.root * self.root * self.root * product)
        bend *= np.float32(-self.group.weight * FACTOR)
        return self.weights * y + inner(bend, self.group.reach) * self.answers

    def hessian(self, q: Array) -> Array:
        """Second derivative of R, applied to an image."""
        turned = np.ascontiguousarray(self.group.filters[:, ::-1, ::-1]) / CONTRAST
        slopes = zip(self.by_answers(*self.along(q)), turned, strict=True)
        return np.sum([cv2.filter2D(slope, -1, w, borderType=0) for slope, w in slopes], axis=0)

    def by_parameters(self, f: Array, q: Array) -> Array:
        """Derivative of ``q' grad R(f)`` by taps, log a and log e."""
        group = self.group
        y, product = self.along(q)
        taps = by_taps(self.by_answers(y, product), f, group.reach)
        taps += by_taps(self.weights * self.answers, q, group.reach)
        taps -= taps.mean((1, 2), keepdims=True)
        by_weight = float((self.root * product).sum())
        by_smoothing = -(group.smoothing**2) * float((self.root**3 * product).sum())
        rest = group.weight * FACTOR * np.array([by_weight, by_smoothing])
        return np.concatenate([taps.ravel(), rest])


def inner(images: Array, rim: int) -> Array:
    """Images with a border of 0."""
    out = np.zeros_like(images)
    out[..., rim:-rim, rim:-rim] = images[..., rim:-rim, rim:-rim]
    return out


def by_taps(slopes: Array, image: Array, reach: int) -> Array:
    """Derivative by the taps of filters from that by their answers to an image."""
    side = 2 * reach + 1
    windows = sliding_window_view(image, (side, side)).reshape(-1, side**2)
    rows = slopes[:, reach:-reach, reach:-reach].reshape(len(slopes), -1)
    return (rows @ windows).reshape(-1, side, side).astype(np.float64) / CONTRAST


def derivative(given: Picture, prior: FilterPrior) -> tuple[float, list[Array]]:
    """PSNR of the minimiser, and its derivative by taps, log a and log e of every group.

    The minimiser is where ``grad R + A f = b``: with ``(A + Hessian) q = dPSNR / df`` the
    derivative by a parameter t is ``-q' d grad R / dt``.
    """
    f = reconstructed(given, prior, 1.0)
    error = np.zeros_like(f)
    error[given.inside] = (f - given.truth)[given.inside]
    by_image = -20 / np.log(10) * error / (error**2).sum()

    groups = [Linearised.of(group, f) for group in prior.groups]

    def whole(v: Array) -> Array:
        return np.asarray(given.data(v) + sum(group.hessian(v) for group in groups))

    peak = (given.blur**2).sum() ** 2 / given.noise**2
    diagonal = peak + prior.majoriser(f, FACTOR).diagonal
    q = solved(whole, by_image, diagonal, np.zeros_like(f), ADJOINT_STEPS)
    return given.psnr(f), [-group.by_parameters(f, q) for group in groups]


def even(image: Array, axis: int) -> Array:
    """Part that is the same when mirrored."""
    return (image + np.flip(image, axis)) / 2


def symmetric(index: int, filters: Array) -> Array:
    """Filters as near as can be of which mirrored and turned ones are in the group, but for signs.

    A pair is a filter and its transpose, or its mirror image. The first group has one that is even
    along both axes and one that lies along the diagonals, the second one that is odd along one
    axis and another one that is even along both: a module on its side is the same module.
    """
    first, second = (filters[0] + filters[1].T) / 2, (filters[2] + filters[3].T) / 2
    if index == 0:
        along = (filters[2] + filters[3][:, ::-1]) / 2
        along = (along + along.T) / 2
        along = (along + along[::-1, ::-1]) / 2
        first = even(even(first, 0), 1)
        pairs = [first, first.T, along, along[:, ::-1]]
    else:
        first = even(first - even(first, 1), 0)
        second = even(even(second, 0), 1)
        pairs = [first, first.T, second, second.T]
    made = np.array(pairs)
    return np.asarray(made - made.mean((1, 2), keepdims=True))


def first_groups() -> list[FilterGroup]:
    """Second differences; slopes and fourth differences."""
    at = np.arange(-REACH, REACH + 1)
    second = np.select([at == 0, np.abs(at) == 1], [-2.0, 1.0])
    fourth = np.array([1.0, -4.0, 6.0, -4.0, 1.0]) / 6
    middle = np.eye(2 * REACH + 1)[REACH]
    bell = np.exp(-(at**2) / 2) / np.exp(-(at**2) / 2).sum()
    row, finer = np.outer(middle, second), np.outer(bell, fourth)
    slope = np.outer(bell, -at * bell)
    diagonal = np.diag(second) / 2
    curved = np.array([row, row.T, diagonal, diagonal[:, ::-1]])
    rest = np.array([slope, slope.T, finer, finer.T])
    return [
        FilterGroup(symmetric(0, curved), 0.5, 0.75),
        FilterGroup(symmetric(1, rest), 0.04, 0.75),
    ]


def fitted(files: Sequence[Path], steps: int) -> Iterator[list[FilterGroup]]:
    """Adam on the derivative of the mean PSNR; yields the filters after every step."""
    groups = first_groups()
    sizes = [group.filters.size for group in groups]
    values = np.concatenate(
        [np.append(g.filters.ravel(), np.log([g.weight, g.smoothing])) for g in groups]
    )
    rates = np.concatenate([np.append(np.full(n, 0.012), [0.05, 0.02]) for n in sizes])
    first, second = np.zeros_like(values), np.zeros_like(values)
    for step in range(1, steps + 1):
        prior = FilterPrior(CONTRAST, groups)
        drawn = [picture(files, 10_000 + step * BATCH + k) for k in range(BATCH)]
        made = parallel_map(lambda given, prior=prior: derivative(given, prior), drawn)
        slope = np.mean([np.concatenate(each) for _, each in made], axis=0)
        first = 0.9 * first + 0.1 * slope
        second = 0.98 * second + 0.02 * slope**2
        move = first / (1 - 0.9**step) / (np.sqrt(second / (1 - 0.98**step)) + 1e-9)
        values += rates * min(1.0, 2 * (1 - step / steps) + 0.05) * move
        at, groups = 0, []
        for index, n in enumerate(sizes):
            taps = values[at : at + n].reshape(FILTERS, 2 * REACH + 1, 2 * REACH + 1)
            taps[:] = symmetric(index, taps)
            weight, smoothing = np.exp(values[at + n : at + n + 2])
            groups.append(FilterGroup(taps.copy(), float(weight), float(smoothing)))
            at += n + 2
        if step % 25 == 0:
            print(f"{step:4d} {np.mean([p for p, _ in made]):7.3f} dB {process_time():6.0f} CPU s")
        yield groups


def write(groups: Sequence[FilterGroup]) -> None:
    """Write the filters of the package, with taps that add up to 0."""
    stored = []
    for group in groups:
        taps = group.filters.round(5)
        taps[:, REACH, REACH] -= taps.sum((1, 2))
        stored.append(
            {
                "weight": round(group.weight, 5),
                "smoothing": round(group.smoothing, 5),
                "filters": taps.round(5).tolist(),
            }
        )
    WEIGHTS.write_text(json.dumps({"groups": stored}, indent=1) + "\n", encoding="utf-8")


def judge(name: str, prior: Prior, pictures: Sequence[Picture], weights: Array) -> None:
    """Print the PSNR of a prior."""
    order = np.argsort([given.frame_noise for given in pictures])
    thirds = np.array_split(order, 3)

    def row(weight: float) -> list[float]:
        return parallel_map(lambda given: given.psnr(reconstructed(given, prior, weight)), pictures)

    table = np.array([row(float(weight)) for weight in weights])
    best = int(table.mean(1).argmax())
    for what, psnr in ((f"lambda {weights[best]:g}", table[best]), ("own lambda", table.max(0))):
        by_noise = "  ".join(f"{psnr[third].mean():.2f}" for third in thirds)
        print(f"{name:18} {what:14} {psnr.mean():6.2f} dB   by noise {by_noise}", flush=True)


def main() -> None:
    """Learn, if asked for, and judge."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("cells", type=Path)
    parser.add_argument("--fit", action="store_true")
    parser.add_argument("--steps", type=int, default=300)
    parser.add_argument("--pictures", type=int, default=24)
    parser.add_argument(
        "--first-seed", type=int, default=900_000, help="of the pictures that judge"
    )
    args = parser.parse_args()
    cv2.setNumThreads(1)  # the pictures run side by side
    prior = learned_prior(CONTRAST)
    if args.fit:
        for groups in fitted(sorted((args.cells / "train" / "img").iterdir()), args.steps):
            prior = FilterPrior(CONTRAST, groups)
        write(prior.groups)
    val = sorted((args.cells / "val" / "img").iterdir())
    pictures = [picture(val, args.first_seed + k) for k in range(args.pictures)]
    judge("sparse curvature", sparse_curvature(CONTRAST), pictures, 2.0 ** np.arange(-3, 3))
    judge("learned", prior, pictures, 2.0 ** np.arange(-2, 3))


if __name__ == "__main__":
    main()
