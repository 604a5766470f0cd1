"""Training needs torch, which the program does not."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest

torch = pytest.importorskip("torch", reason="torch is not installed: only training needs it")

from pv_inspect.cracks import NetworkDetector  # noqa: E402
from pv_inspect.cracks.classes import CRACK  # noqa: E402
from pv_inspect.cracks.training.feeding import Recipe, batches  # noqa: E402
from pv_inspect.cracks.training.known_looks import known_looks  # noqa: E402
from pv_inspect.cracks.training.labelled import LabelledCell  # noqa: E402
from pv_inspect.cracks.training.train import (  # noqa: E402
    CrackNet,
    describe,
    train,
    write_onnx,
)


def cells(n: int = 6) -> list[LabelledCell]:
    rng = np.random.default_rng(0)
    made = []
    for k in range(n):
        image = np.full((96, 96), 180, np.uint8)
        label = np.zeros((96, 96), np.uint8)
        if k % 2:
            ends = [tuple(map(int, p)) for p in rng.integers(5, 90, (2, 2))]
            cv2.line(image, *ends, 60, 3)
            cv2.line(label, *ends, CRACK, 3)
        made.append(LabelledCell(f"M{k}_1", image, label))
    return made


def test_the_network_is_small_and_keeps_the_size() -> None:
    net = CrackNet()
    assert 0.2e6 < sum(p.numel() for p in net.parameters()) < 0.3e6
    assert net(torch.zeros(2, 1, 64, 96)).shape == (2, 5, 64, 96)


def test_the_same_seed_draws_the_same_batches() -> None:
    drawn = [next(batches(cells(), Recipe(seed=3))) for _ in "ab"]
    assert np.array_equal(drawn[0][0], drawn[1][0])


def test_training_ends_when_its_time_is_over(tmp_path: Path) -> None:
    recipe = Recipe(steps=10**9, batch=2)
    train(cells(), [], tmp_path, recipe, judge_every=10**9, minutes=0.005)
    assert (tmp_path / "state.pt").is_file()


def test_a_trained_network_is_written_with_its_description(tmp_path: Path) -> None:
    pytest.importorskip("onnx", reason="torch needs onnx to write a network")
    net = train(cells(), cells(), tmp_path, Recipe(steps=2, batch=2), judge_every=2)
    write_onnx(net, tmp_path / "network.onnx")
    looks = known_looks(cells(), cells(), Recipe(batch=2), drawn=40)
    describe(tmp_path / "network.onnx", "tiny network", cells(), looks=looks)
    assert (tmp_path / "log.csv").read_text().startswith("step,loss,crack_ap")
    assert json.loads((tmp_path / "network.json").read_text())["name"] == "tiny network"
    detector = NetworkDetector(tmp_path / "network.onnx")
    assert detector.novelty(np.asarray(cells()[1].image, np.float32)) < 1
    assert detector.probability(np.asarray(cells()[1].image, np.float32)).shape == (96, 96)
