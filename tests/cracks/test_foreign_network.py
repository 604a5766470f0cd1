"""Networks that are not ours run in a process of their own, whatever they do there."""

from __future__ import annotations

import gc
import hashlib
import json
import re
import shutil
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from pv_inspect.cracks import NetworkDetector, network
from pv_inspect.cracks import foreign_network as apart
from pv_inspect.errors import InspectionError
from tests.cracks.test_network import cell


@pytest.fixture
def model(tmp_path: Path) -> Iterator[Path]:
    """A copy of the default model that may be changed."""
    source = Path(network.__file__).with_name("models")
    for kind in ("onnx", "json"):
        shutil.copy(source / f"default.{kind}", tmp_path / f"m.{kind}")
    yield tmp_path / "m.onnx"
    network._opened.cache_clear()
    gc.collect()


def rewrite(model: Path, data: bytes) -> None:
    """Put a network in place of the model, with the hash that belongs to it beside it."""
    model.write_bytes(data)
    about = json.loads(model.with_suffix(".json").read_text())
    about["sha256"] = hashlib.sha256(data).hexdigest()
    model.with_suffix(".json").write_text(json.dumps(about))


def with_attribute(data: bytes, name: bytes, value: int) -> bytes:
    """A network whose every whole-number attribute of a name has another value under 128."""
    before = b"\x0a" + bytes([len(name)]) + name + b"\x18"
    parts = data.split(before)
    assert len(parts) > 1
    return before.join([parts[0], *(bytes([value]) + part[1:] for part in parts[1:])])


def test_our_own_models_run_here_and_any_other_apart(model: Path) -> None:
    ours = NetworkDetector(model)
    assert not isinstance(ours._net, apart.NetworkApart)
    data = bytearray(model.read_bytes())
    data[len(data) // 2] ^= 1  # the last digits of a weight
    rewrite(model, bytes(data))
    other = NetworkDetector(model)
    assert isinstance(other._net, apart.NetworkApart)
    images = np.stack([cell(120, 130), cell(120, 130, crack=False)])
    for found, wanted in zip(other.read_many(images), ours.read_many(images), strict=True):
        np.testing.assert_allclose(found, wanted, atol=0.05)


def test_a_network_that_ends_its_process_is_told_and_ends_no_other(
    model: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    rewrite(model, with_attribute(model.read_bytes(), b"group", 0))
    for _ in range(2):
        with pytest.raises(InspectionError, match=r"m\.onnx .*(SIGFPE|crack model)"):
            NetworkDetector(model)
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize("seed", range(12))
def test_a_byte_changed_anywhere_is_a_model_or_one_sentence(
    model: Path, seed: int, capfd: pytest.CaptureFixture[str]
) -> None:
    """Where the layers are described: names, numbers and lengths."""
    data = bytearray(model.read_bytes())
    rng = np.random.default_rng(seed)
    places = [found.start() for found in re.finditer(b"Conv|pads|grou|stri", data)]
    at = int(rng.choice(places)) + int(rng.integers(40))
    data[at] = int(rng.integers(256))
    rewrite(model, bytes(data))
    try:
        maps = NetworkDetector(model).probability(cell(64, 64))
    except InspectionError:
        pass
    else:
        assert np.isfinite(maps).all()
    assert capfd.readouterr() == ("", "")


READS = "sys.stdout.flush(); sys.stdin.buffer.read()"
PROGRAMS = {
    "sleeps": ("import time; time.sleep(60)", r"takes over 0\.5 s"),
    "ends": ("raise SystemExit(3)", "ends the process that runs it"),
    "is killed": ("import os, signal; os.kill(os.getpid(), signal.SIGSEGV)", "SIGSEGV"),
    "says nothing": ("import sys; sys.stdout.close(); sys.stdin.read()", "takes over|ends the"),
    "says nonsense": ("print(1000 * 'nonsense ')", "axes|ends the process"),
    "returns too much": (
        "import struct, sys; sys.stdout.buffer.write(struct.pack('<I4Q', 4, *4 * [10**6]));"
        + READS,
        "it returns",
    ),
    "returns infinity": (
        "import struct, sys; sys.stdout.buffer.write(struct.pack('<I4Q', 4, 2, 5, 32, 48)"
        " + 2 * 5 * 32 * 48 * struct.pack('<f', float('inf')));" + READS,
        "is no crack model",
    ),
}


@pytest.mark.parametrize("what", PROGRAMS)
def test_whatever_the_process_does_is_one_sentence(
    model: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, what: str
) -> None:
    program, said = PROGRAMS[what]
    (tmp_path / "program.py").write_text(program)
    monkeypatch.setattr(apart, "_PROGRAM", tmp_path / "program.py")
    if "takes over" in said:
        monkeypatch.setattr(apart, "LONGEST_S", 0.5)
    rewrite(model, model.read_bytes() + b"\x00\x00")
    with pytest.raises(InspectionError, match=rf"m\.onnx .*({said})"):
        NetworkDetector(model)


def test_a_network_that_fails_later_is_told_for_that_cell(model: Path) -> None:
    data = bytearray(model.read_bytes())
    data[len(data) // 2] ^= 1
    rewrite(model, bytes(data))
    detector = NetworkDetector(model)
    detector._net._process.kill()
    with pytest.raises(InspectionError, match=r"ends the process that runs it \(SIGKILL\)"):
        detector.probability(cell(64, 64))


def test_the_process_ends_with_the_detector(model: Path) -> None:
    data = bytearray(model.read_bytes())
    data[len(data) // 2] ^= 1
    rewrite(model, bytes(data))
    process = NetworkDetector(model)._net._process
    assert process.poll() is None
    network._opened.cache_clear()
    gc.collect()
    for _ in range(600):
        if process.poll() is not None:
            return
        time.sleep(0.1)
    pytest.fail("the process lives on")


def test_a_file_larger_than_any_model_is_not_read(
    model: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(network, "_MOST_BYTES", 1000)
    with pytest.raises(InspectionError, match="no crack model has more than"):
        NetworkDetector(model)


def test_the_hashes_of_our_models_are_those_of_the_package() -> None:
    folder = Path(network.__file__).with_name("models")
    found = {hashlib.sha256(path.read_bytes()).hexdigest() for path in folder.glob("*.onnx")}
    assert found == network._OURS
