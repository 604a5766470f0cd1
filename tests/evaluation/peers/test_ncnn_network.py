"""Networks that ncnn runs: a network of known effect, the published ones, and what is missing."""

from __future__ import annotations

from importlib.metadata import PackageNotFoundError
from importlib.util import find_spec
from pathlib import Path

import cv2
import numpy as np
import pytest

from pv_inspect.errors import InspectionError
from pv_inspect.evaluation.methods import PEERS, PublishedNetwork, methods_named
from pv_inspect.evaluation.peers.ncnn_network import NcnnNetwork
from pv_inspect.evaluation.peers.package_files import file_of_package

NEAREST = """7767517
2 2
Input  in  0 1 data
Interp up  1 1 data output 0=1 1=4.0 2=4.0
"""
needs_ncnn = pytest.mark.skipif(
    find_spec("ncnn") is None,
    reason="ncnn is not installed: pip install 'pv-inspect[peers]'",
)


@needs_ncnn
def test_the_colours_of_the_network_come_back_as_one(tmp_path: Path) -> None:
    (tmp_path / "near.param").write_text(NEAREST)
    (tmp_path / "near.bin").write_bytes(b"")
    image = np.random.default_rng(0).random((7, 9), np.float32)
    found = NcnnNetwork(tmp_path / "near.param", 4).enlarged(image)
    assert np.allclose(found, np.kron(image, np.ones((4, 4))), atol=1e-6)


@needs_ncnn
def test_a_network_of_another_scale_is_refused(tmp_path: Path) -> None:
    (tmp_path / "near.param").write_text(NEAREST)
    (tmp_path / "near.bin").write_bytes(b"")
    with pytest.raises(InspectionError, match=r"\(3, 28, 36\) instead of \(3, 14, 18\)"):
        NcnnNetwork(tmp_path / "near.param", 2).enlarged(np.zeros((7, 9), np.float32))


def test_a_missing_package_is_named_with_what_installs_it() -> None:
    with pytest.raises(InspectionError, match="no-such-weights, which is not installed: pip x"):
        file_of_package("no-such-weights", "a/b.param", "pip x")


def test_a_package_without_the_file_is_named() -> None:
    with pytest.raises(InspectionError, match="numpy is installed, but without a/b"):
        file_of_package("numpy", "a/b.param", "pip x")


def test_networks_of_others_are_compared_where_named_only() -> None:
    assert not {m.name for m in methods_named([])} & {m.name for m in PEERS}
    assert [m.name for m in methods_named(["realsr", "Bicubic"])] == ["BICUBIC", "RealSR"]


@needs_ncnn
@pytest.mark.parametrize("method", [m for m in PEERS if isinstance(m, PublishedNetwork)])
def test_an_edge_becomes_sharper_and_does_not_move(method: PublishedNetwork) -> None:
    try:
        network = NcnnNetwork(file_of_package(method.package, method.param, "pip"), 4)
    except InspectionError as error:
        if isinstance(error.__context__, PackageNotFoundError):
            pytest.skip(f"{method.package} is not installed: {method.install}")
        raise
    fine = np.full((96, 96), 0.1, np.float32)
    fine[:, 46:] = 0.8
    coarse = cv2.resize(fine, (24, 24), interpolation=cv2.INTER_AREA)
    plain = cv2.resize(coarse, (96, 96), interpolation=cv2.INTER_CUBIC)
    found = network.enlarged(np.asarray(coarse, np.float32))
    errors = [np.mean((image - fine)[16:-16, 16:-16] ** 2) for image in (plain, found)]
    assert errors[1] < errors[0]
    profile = found[48, 38:54]
    assert abs(np.interp(0.45, profile, np.arange(38, 54)) - 45.5) < 0.5
