"""Batches of training cells, drawn in this process or in several."""

from __future__ import annotations

import multiprocessing
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from queue import Full
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from pv_inspect.cracks.training.augmentation import Augmentation, prepared
from pv_inspect.cracks.training.diversified import Diversity
from pv_inspect.cracks.training.labelled import LabelledCell

__all__ = ["CRACKED_PX", "Recipe", "batches", "many_batches"]

Batch = tuple[NDArray[np.float32], NDArray[np.uint8]]
Cell = NDArray[np.uint8]

# A cell with fewer crack pixels counts as one without.
CRACKED_PX = 40
# The network halves the image four times; it is padded by mirroring, as in `NetworkDetector`.
_STRIDE = 16
# Batches that each process has ready.
_AHEAD = 6


@dataclass(frozen=True)
class Recipe:
    """How the network is trained.

    Parameters
    ----------
    steps : int
        Batches; the learning rate falls to 0 over them as a cosine.
    batch : int
        Cells per batch.
    learning_rate, weight_decay : float
        Of AdamW.
    averaging : float
        Weight of the past in the moving average of the weights, per step.
    cracked_share : float
        Share of the drawn cells that have cracks.
    cut_share : float
        Share of the batches that are cut into parts of cells: halves, with ``diverse`` thirds too.
    degrade : bool
        See `Augmentation`.
    diverse : bool
        Cells of other makers as well, see `Diversity`; with ``degrade`` only.
    seed : int
    """

    steps: int = 6000
    batch: int = 8
    learning_rate: float = 3e-3
    weight_decay: float = 1e-3
    averaging: float = 0.995
    cracked_share: float = 0.55
    cut_share: float = 0.2
    degrade: bool = True
    diverse: bool = True
    seed: int = 0


def batches(cells: list[LabelledCell], recipe: Recipe) -> Iterator[Batch]:
    """Draw batches without end.

    Parameters
    ----------
    cells : list of LabelledCell
    recipe : Recipe

    Yields
    ------
    inputs : (n, 1, h, w) float32
    labels : (n, h, w) uint8
        ``recipe.batch`` cells, or as many times more parts of cells as a cell has; h and w are
        multiples of 16.
    """
    rng = np.random.default_rng(recipe.seed)
    diverse = recipe.degrade and recipe.diverse
    augment = Augmentation(recipe.degrade, Diversity() if diverse else None)
    small = [prepared(cell.image, cell.label) for cell in cells]
    cracked = np.array([int(cell.crack.sum()) >= CRACKED_PX for cell in cells])
    pools = [np.flatnonzero(cracked), np.flatnonzero(~cracked)]
    while True:
        cut = recipe.degrade and rng.random() < recipe.cut_share
        parts = int(rng.choice([2, 2, 3])) if cut and diverse else 2 if cut else 1
        upright = rng.random() < 0.5
        inputs, labels = [], []
        for _ in range(recipe.batch * parts):
            pool = pools[0] if rng.random() < recipe.cracked_share else pools[1]
            image, label = small[int(rng.choice(pool))]
            if parts > 1:
                image, label = _part(image, label, parts, rng)
            seen, classes = augment(image, label, rng)
            if parts > 1 and (seen.shape[0] > seen.shape[1]) != upright:
                seen, classes = np.rot90(seen), np.rot90(classes)
            lacking = [(0, -n % _STRIDE) for n in seen.shape]
            inputs.append(np.pad(seen, lacking, mode="reflect"))
            labels.append(np.pad(classes, lacking, mode="reflect"))
        yield np.stack(inputs)[:, None], np.stack(labels)


def _part(image: Cell, label: Cell, parts: int, rng: np.random.Generator) -> tuple[Cell, Cell]:
    """One of equal parts of a cell, cut along or across the busbars."""
    if rng.random() < 0.5:
        image, label = image.T, label.T
    n = image.shape[0] // parts
    start = int(rng.integers(parts)) * n
    return (
        np.ascontiguousarray(image[start : start + n]),
        np.ascontiguousarray(label[start : start + n]),
    )


@contextmanager
def many_batches(
    cells: list[LabelledCell], recipe: Recipe, processes: int
) -> Iterator[Iterator[Batch]]:
    """Draw batches in several processes, which end with the context.

    Parameters
    ----------
    cells : list of LabelledCell
    recipe : Recipe
        The order of the batches depends on its seed and on the number of processes alone.
    processes : int
        0 to draw in this process.

    Yields
    ------
    iterator
        Of `batches`.
    """
    if not processes:
        yield batches(cells, recipe)
        return
    # A forked process hangs where another thread of this one held a lock, OpenCV's say.
    context = multiprocessing.get_context("spawn")
    queues = [context.Queue(_AHEAD) for _ in range(processes)]
    workers = [
        context.Process(
            target=_draw,
            args=(cells, replace(recipe, seed=recipe.seed + 1000 * (k + 1)), queue),
            daemon=True,
        )
        for k, queue in enumerate(queues)
    ]
    for worker in workers:
        worker.start()

    def in_turn() -> Iterator[Batch]:
        while True:
            for queue in queues:
                yield queue.get(timeout=120)

    try:
        yield in_turn()
    finally:
        for worker in workers:
            worker.terminate()
            worker.join(10)


def _draw(cells: list[LabelledCell], recipe: Recipe, queue: Any) -> None:
    cv2.setNumThreads(1)
    for batch in batches(cells, recipe):
        while True:
            try:
                queue.put(batch, timeout=60)
                break
            except Full:
                continue
