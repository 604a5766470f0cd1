"""What detection, calibration and registration together must not depend on."""

from __future__ import annotations

import json
from collections.abc import Generator
from pathlib import Path
from typing import TypeVar

import numpy as np
import pytest
import tifffile

from pv_inspect.calibration import calibrate
from pv_inspect.detection import detect
from pv_inspect.registration import Registration, register
from pv_inspect.sequence import Sequence
from pv_inspect.settings import Settings
from pv_inspect.simulate import SimulatedSequence

T = TypeVar("T")
Small = tuple[SimulatedSequence, Path]

ROWS, COLS, N = 4, 6, 8


def finish(generator: Generator[float, None, T]) -> T:
    while True:
        try:
            next(generator)
        except StopIteration as done:
            result: T = done.value
            return result


def located(sequence: Sequence, settings: Settings) -> Registration:
    crossings = finish(detect(sequence, sequence.layout(settings)))
    calibration = calibrate(crossings, sequence.shape, settings)
    return finish(register(sequence, calibration, settings))


def crossings_px(registration: Registration) -> np.ndarray:
    """All crossings, (n_frames, rows + 1, cols + 1, 2)."""
    assert registration.used.all()
    layout = registration.layout
    points = [registration.crossings_px(i) for i in range(len(registration.used))]
    return np.array(points).reshape(-1, layout.rows + 1, layout.cols + 1, 2)


def rms(difference: np.ndarray) -> float:
    return float(np.sqrt(np.mean(np.sum(difference**2, axis=-1))))


def written(folder: Path, frames: np.ndarray) -> Path:
    folder.mkdir()
    for i, frame in enumerate(frames):
        tifffile.imwrite(folder / f"frame_{i:03d}.tif", frame)
    return folder


@pytest.fixture(scope="module")
def settings() -> Settings:
    return Settings(rows=ROWS, cols=COLS)


@pytest.fixture(scope="module")
def usual(small_sequence: Small, settings: Settings) -> np.ndarray:
    return crossings_px(located(Sequence.open(small_sequence[1]), settings))


def test_the_order_of_the_frames_does_not_matter(
    small_sequence: Small, settings: Settings, usual: np.ndarray
) -> None:
    order = np.random.default_rng(2).permutation(N)
    files = sorted((small_sequence[1] / "frames").iterdir())
    shuffled = crossings_px(located(Sequence.open([files[i] for i in order]), settings))
    print(rms(shuffled - usual[order]), np.abs(shuffled - usual[order]).max())


def test_the_brightness_does_not_matter(
    small_sequence: Small, settings: Settings, usual: np.ndarray, tmp_path: Path
) -> None:
    frames = small_sequence[0].frames
    for k in (2, 3, 16):
        scaled = crossings_px(
            located(Sequence.open(written(tmp_path / f"x{k}", k * frames)), settings)
        )
        print(k, rms(scaled - usual), np.abs(scaled - usual).max())


def test_a_transposed_module_has_transposed_crossings(
    small_sequence: Small, usual: np.ndarray, tmp_path: Path
) -> None:
    frames = small_sequence[0].frames.transpose(0, 2, 1)
    folder = written(tmp_path / "transposed", frames)
    (folder / "module.json").write_text(json.dumps({"rows": COLS, "cols": ROWS, "cell_aspect": 1}))
    turned = crossings_px(located(Sequence.open(folder), Settings()))
    back = turned.transpose(0, 2, 1, 3)[..., ::-1]
    print(rms(back - usual), np.abs(back - usual).max())
