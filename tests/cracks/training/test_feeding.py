from __future__ import annotations

import numpy as np

from pv_inspect.cracks.training.feeding import Recipe, batches, many_batches
from pv_inspect.cracks.training.labelled import LabelledCell


def cells() -> list[LabelledCell]:
    rng = np.random.default_rng(0)
    label = np.zeros((96, 96), np.uint8)
    label[40:44, 10:80] = 3
    images = rng.integers(80, 200, (4, 96, 96), np.uint8)
    return [
        LabelledCell(f"M_{k}", image, label * np.uint8(k % 2)) for k, image in enumerate(images)
    ]


def test_whole_half_and_third_cells_fit_the_network() -> None:
    shapes = set()
    drawn = batches(cells(), Recipe(batch=1, cut_share=0.8))
    for _ in range(25):
        inputs, labels = next(drawn)
        assert inputs.shape[0] == labels.shape[0]
        assert inputs.shape[2:] == labels.shape[1:]
        assert not any(n % 16 for n in labels.shape[1:])
        shapes.add((len(labels), tuple(sorted(labels.shape[1:]))))
    assert shapes == {(1, (256, 256)), (2, (128, 256)), (3, (96, 256))}


def test_processes_draw_other_batches_than_each_other_and_the_same_again() -> None:
    def first(n: int) -> list[float]:
        with many_batches(cells(), Recipe(batch=1), 2) as drawn:
            return [float(next(drawn)[0].sum()) for _ in range(n)]

    found = first(4)
    assert len(set(found)) == 4
    assert first(4) == found
