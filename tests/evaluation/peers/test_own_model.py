"""A network of the user's own: run as its description says, or refused in one sentence."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from pv_inspect.cracks.foreign_network import NetworkApart
from pv_inspect.errors import InspectionError
from pv_inspect.evaluation.peers.own_model import OwnModel

DECLARED = 'layout = "nchw"\nchannels = 1\nvalue_range = [-1.0, 1.0]\nscale = 2\n'


def field(number: int, value: bytes | str | int) -> bytes:
    """A field of a protocol buffer; all numbers and lengths here are small."""
    if isinstance(value, int):
        return bytes([number << 3, value])
    data = value.encode() if isinstance(value, str) else value
    assert len(data) < 2**14
    length = [len(data)] if len(data) < 128 else [len(data) & 127 | 128, len(data) >> 7]
    return bytes([number << 3 | 2, *length]) + data


def tensor_info(name: str, sides: tuple[int | str, ...]) -> bytes:
    shape = b"".join(
        field(1, field(2, side) if isinstance(side, str) else field(1, side)) for side in sides
    )
    return field(1, name) + field(2, field(1, field(1, 1) + field(2, shape)))


def doubling_network(n_channels: int) -> bytes:
    """A transposed convolution that makes 2 x 2 equal pixels of one, for each channel."""
    weights = np.zeros((n_channels, n_channels, 2, 2), "<f4")
    weights[range(n_channels), range(n_channels)] = 1
    tensor = b"".join(field(1, side) for side in weights.shape)
    tensor += field(2, 1) + field(8, "w") + field(9, weights.tobytes())
    attributes = b"".join(
        field(5, field(1, name) + field(8, 2) + field(8, 2) + b"\xa0\x01\x07")
        for name in ("strides", "kernel_shape")
    )
    node = field(1, "x") + field(1, "w") + field(2, "y") + field(4, "ConvTranspose") + attributes
    sides = (1, n_channels, "h", "w")
    graph = field(1, node) + field(2, "g") + field(5, tensor)
    graph += field(11, tensor_info("x", sides)) + field(12, tensor_info("y", sides))
    return field(1, 8) + field(7, graph) + field(8, field(2, 13))


@pytest.fixture
def model(tmp_path: Path) -> Path:
    (tmp_path / "mine.onnx").write_bytes(doubling_network(1))
    (tmp_path / "mine.toml").write_text(DECLARED)
    return tmp_path / "mine.onnx"


def made(path: Path, video: NDArray[np.float32]) -> NDArray[np.float32]:
    network = NetworkApart(path, path.read_bytes())
    try:
        return OwnModel.read(path, []).enlarged(network, video, 0)
    finally:
        network.close()


@pytest.mark.parametrize("n_channels", [1, 3])
def test_a_network_is_given_what_it_declares(model: Path, n_channels: int) -> None:
    model.write_bytes(doubling_network(n_channels))
    text = DECLARED.replace("channels = 1", f"channels = {n_channels}")
    model.with_suffix(".toml").write_text(text)
    video = np.random.default_rng(0).random((1, 6, 7), np.float32)
    assert np.allclose(made(model, video), np.kron(video[0], np.ones((2, 2))), atol=1e-6)


def test_another_scale_than_declared_is_refused(model: Path) -> None:
    model.with_suffix(".toml").write_text(DECLARED.replace("scale = 2", "scale = 3"))
    with pytest.raises(InspectionError, match=r"\(1, 1, 12, 14\).*wants pictures of 18 x 21"):
        made(model, np.zeros((1, 6, 7), np.float32))


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("scale = 2\n", "does not describe a network"),
        (DECLARED + "colour = 3\n", "colour"),
        (DECLARED.replace("-1.0, 1.0", "1.0, 1.0"), "black < white"),
        (DECLARED + "frames = 5\n", "ntchw"),
    ],
)
def test_a_wrong_description_is_refused(model: Path, text: str, why: str) -> None:
    model.with_suffix(".toml").write_text(text)
    with pytest.raises(InspectionError, match=why):
        OwnModel.read(model, [])


def test_a_name_that_another_method_has_is_refused(model: Path) -> None:
    with pytest.raises(InspectionError, match="rename it"):
        OwnModel.read(model, ["MINE"])


def test_a_network_with_no_description_is_refused(model: Path) -> None:
    model.with_suffix(".toml").unlink()
    with pytest.raises(InspectionError, match=r"write mine\.toml beside it"):
        OwnModel.read(model, [])


def test_its_note_tells_the_scaling_and_which_network_it_was(model: Path) -> None:
    own = OwnModel.read(model, [])
    assert (own.name, own.frames) == ("mine", "one")
    assert "-1 to 1 is black" in own.note
    assert own.sha256[:12] in own.note
