from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

onnx = pytest.importorskip("onnx")
MODELS = Path(__file__).parents[3] / "pv_inspect" / "cracks" / "models"


def answer(path: Path, cells: np.ndarray) -> np.ndarray:
    net = cv2.dnn.readNetFromONNX(str(path))
    net.setInput(cells)
    return np.array(net.forward())


def test_a_joined_network_answers_with_the_mean_of_its_parts(tmp_path: Path) -> None:
    from pv_inspect.cracks.training.ensemble import join

    parts = [MODELS / "default.onnx", MODELS / "sharp.onnx"]
    join(parts, tmp_path / "mean.onnx")
    cells = np.random.default_rng(0).random((2, 1, 64, 96), np.float32)
    mean = np.mean([answer(part, cells) for part in parts], axis=0)
    np.testing.assert_allclose(answer(tmp_path / "mean.onnx", cells), mean, atol=1e-5)
