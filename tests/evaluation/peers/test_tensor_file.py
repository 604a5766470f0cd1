"""Reading torch's older format without torch: its arrays, and what is refused."""

from __future__ import annotations

import pickle
from pathlib import Path

import numpy as np
import pytest

from pv_inspect.errors import InspectionError
from pv_inspect.evaluation.peers.tensor_file import read_tensors

HEAD = b"".join(pickle.dumps(v, 2) for v in (0x1950A86A20F9469CFC6C, 1001, {}))
STORAGE = b"(Vstorage\nctorch\nFloatStorage\nV7\nVcpu\nI7\nNtQ"
KEYS = pickle.dumps(["7"], 2)
VALUES = np.arange(7, dtype="<f4")
DATA = np.int64(7).tobytes() + VALUES.tobytes()


def saved(start: int = 1, steps: str = "(I3\nI1\nt") -> bytes:
    """A dictionary of one 2 x 3 array, as torch pickles it."""
    shape = f"(I2\nI3\nt{steps}I00\nccollections\nOrderedDict\n(tR"
    view = b"ctorch._utils\n_rebuild_tensor_v2\n(" + STORAGE + f"I{start}\n{shape}tR".encode()
    return b"(Va.weight\n" + view + b"d."


def test_an_array_comes_back(tmp_path: Path) -> None:
    path = tmp_path / "w.pth"
    path.write_bytes(HEAD + saved() + KEYS + DATA)
    found = read_tensors(path)
    assert list(found) == ["a.weight"]
    assert np.array_equal(found["a.weight"], VALUES[1:].reshape(2, 3))


@pytest.mark.parametrize(
    ("content", "why"),
    [
        (HEAD + b"cos\nsystem\n(Vtrue\ntR.", "wants os.system"),
        (HEAD + saved() + KEYS + DATA[:-1], "ends too early"),
        (HEAD + saved(start=2) + KEYS + DATA, "beyond its values"),
        (HEAD + saved(steps="(I1\nI2\nt") + KEYS + DATA, "no dense one"),
        (HEAD + pickle.dumps({"a": 1}, 2) + KEYS + DATA, "no dictionary of arrays"),
        (b"PK\x03\x04", "older format"),
    ],
)
def test_anything_else_is_refused(tmp_path: Path, content: bytes, why: str) -> None:
    path = tmp_path / "w.pth"
    path.write_bytes(content)
    with pytest.raises(InspectionError, match=why):
        read_tensors(path)
