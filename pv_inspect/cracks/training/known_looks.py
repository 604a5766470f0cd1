"""The looks of training cells, with which a network says what it has not seen."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pv_inspect.cracks.looks import KnownLooks, look_of
from pv_inspect.cracks.training.feeding import Recipe, batches
from pv_inspect.cracks.training.labelled import LabelledCell

__all__ = ["known_looks", "stored_looks"]

# 99.5 % of the varied held-out cells are known. No margin: 162 cells of six simulated modules
# (multi and mono, 2 to 12 busbars, whole and half cells, 58 to 240 px, noise and blur), which were
# not learnt from and are read as well as the learnt ones, lie at 0.70 of that limit at most, their
# median at 0.35.
_QUANTILE, _MARGIN = 0.995, 1.0


def known_looks(
    cells: Sequence[LabelledCell],
    judged: Sequence[LabelledCell],
    recipe: Recipe,
    drawn: int = 4000,
) -> KnownLooks:
    """Measure how the cells look that a network is trained on.

    Parameters
    ----------
    cells, judged : sequence of LabelledCell
        Learnt from, and held out: the latter set the limit.
    recipe : Recipe
        Of the training: the cells are measured as it varies them.
    drawn : int
        Varied cells that are measured, and a quarter of it of ``judged``.

    Returns
    -------
    KnownLooks
    """
    learnt = _looks(cells, recipe, drawn)
    return KnownLooks.of(
        learnt, _looks(judged, recipe, drawn // 4), quantile=_QUANTILE, margin=_MARGIN
    )


def stored_looks(looks: KnownLooks) -> dict[str, Any]:
    """Return known looks as the description of a network stores them."""

    def short(values: Iterable[float]) -> list[float]:
        return [float(f"{value:.5g}") for value in values]

    return {
        "mean": short(looks.mean),
        "whitening": [short(row) for row in looks.whitening],
        "limit": round(looks.limit, 4),
    }


def _looks(cells: Sequence[LabelledCell], recipe: Recipe, n: int) -> NDArray[np.float64]:
    """Looks of the cells as they are and of ``n`` drawn ones, one per row."""
    found = [look_of(np.asarray(cell.image, np.float32)) for cell in cells]
    for inputs, _ in batches(list(cells), recipe):
        if len(found) >= len(cells) + n:
            break
        found += [look_of((x[0] + 1) / 2) for x in inputs]
    return np.array(found)
