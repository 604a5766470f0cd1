from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from pv_inspect.cracks.training.labelled import (
    LabelledCell,
    module_of,
    read_labelled,
    split_modules,
)
from pv_inspect.errors import InspectionError


def written(folder: Path, name: str, image: np.ndarray, label: np.ndarray | None) -> None:
    (folder / "img").mkdir(parents=True, exist_ok=True)
    (folder / "ann").mkdir(exist_ok=True)
    cv2.imwrite(str(folder / "img" / f"{name}.png"), image)
    if label is not None:
        cv2.imwrite(str(folder / "ann" / f"{name}.png"), label)


def test_cells_are_read_with_their_labels(tmp_path: Path) -> None:
    image, label = np.full((20, 30), 9, np.uint8), np.zeros((20, 30), np.uint8)
    label[3, 4] = 3
    written(tmp_path, "A_2", image, label)
    written(tmp_path, "A_1", image, 0 * label)
    cells = read_labelled(tmp_path)
    assert [c.name for c in cells] == ["A_1", "A_2"]
    assert np.argwhere(cells[1].crack).tolist() == [[3, 4]]


@pytest.mark.parametrize(
    ("label", "said"),
    [
        (None, r"A_1\.png is missing: each cell needs"),
        (np.zeros((20, 20), np.uint8), r"is \(20, 20\), the image \(20, 30\)"),
        (np.full((20, 30), 7, np.uint8), r"has class 7, but classes are 0 to 4 \(background"),
    ],
)
def test_wrong_labels_are_told(tmp_path: Path, label: np.ndarray | None, said: str) -> None:
    written(tmp_path, "A_1", np.zeros((20, 30), np.uint8), label)
    with pytest.raises(InspectionError, match=said):
        read_labelled(tmp_path)


def test_an_empty_folder_is_told(tmp_path: Path) -> None:
    with pytest.raises(InspectionError, match="holds no images"):
        read_labelled(tmp_path)


def test_the_module_is_the_beginning_of_the_name() -> None:
    assert module_of("FSEC_6GC16_58") == "FSEC_6GC16"
    assert module_of("cell") == "cell"


def test_no_module_has_cells_in_both_parts() -> None:
    blank = np.zeros((2, 2), np.uint8)
    cells = [LabelledCell(f"M{m}_{k}", blank, blank) for m in range(20) for k in range(1 + m % 4)]
    learnt, judged = split_modules(cells, 0.2)
    assert len(learnt) + len(judged) == len(cells)
    assert len(judged) >= 0.2 * len(cells)
    assert not {module_of(c.name) for c in learnt} & {module_of(c.name) for c in judged}
    assert [c.name for c in split_modules(cells, 0.2)[1]] == [c.name for c in judged]
