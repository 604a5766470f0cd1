from __future__ import annotations

import json
import shutil
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from pv_inspect.cracks import NetworkDetector, network
from pv_inspect.cracks.network import CELL_PX, MODELS
from pv_inspect.cracks.training.labelled import read_labelled
from pv_inspect.cracks.training.scores import pixel_score
from pv_inspect.errors import InspectionError

CELLS = Path(__file__).parents[3] / "shared" / "data" / "cracks" / "val"


def cell(h: int = 300, w: int = 300, *, crack: bool = True) -> np.ndarray:
    """A mono cell with two busbars, and a crack if wanted."""
    image = np.full((h, w), 0.7, np.float32)
    rng = np.random.default_rng(0)
    image += rng.normal(0, 0.01, image.shape).astype(np.float32)
    for k in (1, 3):
        image[k * h // 4 - 2 : k * h // 4 + 3] = 0.15
    if crack:
        ends = (int(0.1 * w), int(0.3 * h)), (int(0.9 * w), int(0.7 * h))
        cv2.line(image, *ends, 0.35, max(round(0.01 * w), 1), cv2.LINE_AA)
    border = max(round(0.015 * w), 1)
    image[:border] = image[-border:] = image[:, :border] = image[:, -border:] = 0.05
    return image


@pytest.fixture
def model(tmp_path: Path) -> Path:
    """A copy of the default model that may be spoilt."""
    source = Path(network.__file__).with_name("models")
    for name in ("default.onnx", "default.json"):
        shutil.copy(source / name, tmp_path / name)
    return tmp_path / "default.onnx"


@pytest.mark.parametrize("name", ["default", "sharp"])
def test_a_drawn_crack_is_found_and_a_clean_cell_is_not_suspected(name: str) -> None:
    detector = NetworkDetector(name)
    assert "network" in detector.name
    cracked = detector.probability(cell())
    assert cracked[150, 150] > 0.5
    assert detector.probability(cell(crack=False)).max() < 0.5
    assert (cracked.dtype, cracked.shape) == (np.float32, (300, 300))
    assert cracked.min() >= 0
    assert cracked.max() <= 1


@pytest.mark.parametrize(
    "size", [(24, 24), (97, 131), (240, 120), (128, 256), (255, 255), (400, 401), (900, 850)]
)
def test_every_size_comes_back_as_it_was(size: tuple[int, int]) -> None:
    cracks, busbars = NetworkDetector().read(cell(*size))
    assert cracks.shape == busbars.shape == size
    assert np.isfinite(cracks).all()


def test_brightness_does_not_matter() -> None:
    detector, image = NetworkDetector(), cell()
    np.testing.assert_allclose(
        detector.probability(image), detector.probability(image * np.float32(0.013)), atol=2e-3
    )


def test_padding_hardly_changes_what_is_far_from_it() -> None:
    detector, image = NetworkDetector(), cell(CELL_PX, CELL_PX)
    whole = detector.probability(image)
    cut = detector._forward(network.normalised(image)[None, :-9])[0]
    assert cut.shape == (5, CELL_PX - 9, CELL_PX)
    same = detector._calibrated(cut[3])
    assert np.abs(same[:150] - whole[:150]).max() < 0.2


def test_a_batch_is_its_cells_one_by_one() -> None:
    detector = NetworkDetector()
    images = np.stack([cell(), cell(crack=False), cell()[::-1]])
    together = detector.read_many(images)[0]
    for image, probability in zip(images, together, strict=True):
        np.testing.assert_allclose(detector.probability(image), probability, atol=1e-4)


def test_a_tile_of_one_value_has_no_cracks() -> None:
    assert not NetworkDetector().probability(np.full((64, 64), 0.3, np.float32)).any()


@pytest.mark.parametrize("name", MODELS)
def test_every_model_of_the_package_names_itself_and_says_more_about_cracked_cells(
    name: str,
) -> None:
    detector = NetworkDetector(name)
    assert "network" in detector.name
    assert detector.probability(cell()).max() > detector.probability(cell(crack=False)).max()


def test_busbars_are_seen() -> None:
    _, busbars = NetworkDetector().read(cell())
    assert busbars[74:77, 40:260].mean() > 0.5
    assert busbars[100:140, 40:260].mean() < 0.1


def test_an_altered_model_is_refused(model: Path) -> None:
    data = bytearray(model.read_bytes())
    data[5000] ^= 1
    model.write_bytes(bytes(data))
    with pytest.raises(InspectionError, match=r"was altered: its SHA-256 begins with .*again"):
        NetworkDetector(model)


@pytest.mark.parametrize("lost", ["default.onnx", "default.json"])
def test_a_missing_model_is_told(model: Path, lost: str) -> None:
    (model.parent / lost).unlink()
    with pytest.raises(InspectionError, match=rf"{lost} is missing: .*ridge"):
        NetworkDetector(model)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"classes": ["background", "crack"]}, "names the classes background, crack, but"),
        ({"classes": None}, "no description of a crack model"),
        ({"calibration": {}}, "no description of a crack model"),
        ({"operating_point": {"level": 1}}, "no description of a crack model"),
        ({"operating_point": {"threshold": 2, "least_extent_cells": 0}}, r"threshold is 2"),
        ({"calibration": {"slope": [1], "offset": 0}}, r"calibration\.slope is \[1\]"),
        ({"calibration": {"slope": 10**400, "offset": 0}}, "a number of 401 digits"),
        ({"name": 5}, "name is 5"),
    ],
)
def test_a_wrong_description_is_told(model: Path, change: dict[str, object], said: str) -> None:
    about = model.with_suffix(".json")
    about.write_text(json.dumps({**json.loads(about.read_text()), **change}))
    with pytest.raises(InspectionError, match=said):
        NetworkDetector(model)


def test_a_file_that_is_no_network_is_told(model: Path) -> None:
    model.write_bytes(b"not a network")
    about = json.loads(model.with_suffix(".json").read_text())
    about["sha256"] = network.hashlib.sha256(b"not a network").hexdigest()
    model.with_suffix(".json").write_text(json.dumps(about))
    with pytest.raises(InspectionError, match="can't be used as a crack model"):
        NetworkDetector(model)


def test_a_network_with_other_outputs_is_told(model: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(network, "_run", lambda _, x: np.zeros((len(x), 2, 32, 48), np.float32))
    network._opened.cache_clear()
    with pytest.raises(InspectionError, match=r"is no crack model: .* returns \(2, 2, 32, 48\)"):
        NetworkDetector(model)
    network._opened.cache_clear()


def test_every_cell_passes_the_network_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """What a module costs; how long that takes is measured by benchmarks/cracks.py."""
    detector = NetworkDetector()
    passed: list[tuple[int, ...]] = []

    def counted(net: Any, inputs: np.ndarray) -> np.ndarray:
        passed.append(inputs.shape)
        return run(net, inputs)

    run = network._run
    monkeypatch.setattr(network, "_run", counted)
    detector.read_many(np.stack([cell(300, 260)] * 20))
    assert [shape[0] for shape in passed] == [8, 8, 4]
    assert {shape[1:] for shape in passed} == {(CELL_PX, 224)}


@pytest.mark.skipif(not CELLS.is_dir(), reason="the labelled cells are not there")
def test_labelled_cracks_are_found() -> None:
    cells = [c for c in read_labelled(CELLS) if c.crack.any()][::6]
    detector = NetworkDetector()
    pairs = [(detector.probability(np.asarray(c.image / 255, np.float32)), c.crack) for c in cells]
    score = pixel_score(pairs)
    assert score.ap > 0.93
    assert score.f1 > 0.89


def test_two_threads_get_what_one_gets() -> None:
    tiles = [cell(120 + 16 * k, 130) for k in range(4)]
    alone = [NetworkDetector().probability(tile) for tile in tiles]
    with ThreadPoolExecutor(2) as pool:
        together = list(pool.map(lambda tile: NetworkDetector().probability(tile), 3 * tiles))
    for found, wanted in zip(together, 3 * alone, strict=True):
        np.testing.assert_array_equal(found, wanted)
