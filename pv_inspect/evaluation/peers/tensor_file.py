"""Arrays of files that torch has saved in its older format, read without torch.

Such a file is a row of pickles and the bare values after them. Nothing of a pickle is run: what
isn't a dictionary of arrays is refused.
"""

from __future__ import annotations

import pickle
from collections import OrderedDict
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from pv_inspect.errors import InspectionError

__all__ = ["read_tensors"]

Tensor = NDArray[np.float32]

_MAGIC = 0x1950A86A20F9469CFC6C
_VERSION = 1001


class _Storage:
    """Values that come later in the file."""

    def __init__(self, key: str) -> None:
        self.key = key


class _View:
    """An array in a storage, as it was saved."""

    def __init__(
        self,
        storage: _Storage,
        start: int,
        shape: tuple[int, ...],
        steps: tuple[int, ...],
        *_: object,
    ) -> None:
        self.storage, self.start, self.shape, self.steps = storage, start, shape, steps

    def of(self, values: Tensor) -> Tensor:
        count = int(np.prod(self.shape))
        if self.steps != _dense_steps(self.shape) or not 0 <= self.start <= values.size - count:
            raise ValueError("an array lies beyond its values or is no dense one")
        return values[self.start : self.start + count].reshape(self.shape)


def _dense_steps(shape: tuple[int, ...]) -> tuple[int, ...]:
    return tuple(int(np.prod(shape[k + 1 :])) for k in range(len(shape)))


_ALLOWED = {
    ("collections", "OrderedDict"): OrderedDict,
    ("torch._utils", "_rebuild_tensor_v2"): _View,
    ("torch", "FloatStorage"): "float32",
}


class _Unpickler(pickle.Unpickler):
    def find_class(self, module: str, name: str) -> Any:
        if (module, name) not in _ALLOWED:
            raise pickle.UnpicklingError(f"it wants {module}.{name}")
        return _ALLOWED[module, name]

    def persistent_load(self, saved: Any) -> _Storage:
        kind, of_type, key = saved[:3]
        if (kind, of_type) != ("storage", "float32"):
            raise pickle.UnpicklingError("it holds values of another type than float32")
        return _Storage(str(key))


def read_tensors(path: Path) -> dict[str, Tensor]:
    """Read the arrays of a network.

    Parameters
    ----------
    path : Path

    Returns
    -------
    dict of str to float32 array

    Raises
    ------
    InspectionError
        If the file can't be read, is of another format or holds something else than arrays.
    """
    try:
        with path.open("rb") as file:
            return _read(file)
    except (
        # All that a damaged pickle raises.
        *(OSError, ValueError, EOFError, pickle.UnpicklingError, TypeError, AttributeError),
        *(KeyError, IndexError, MemoryError, OverflowError),
    ) as error:
        raise InspectionError(
            f"{path} can't be read as weights of torch's older format ({error}): install its "
            "package again."
        ) from None


def _read(file: IO[bytes]) -> dict[str, Tensor]:
    magic, version, _ = (_Unpickler(file).load() for _ in range(3))
    if (magic, version) != (_MAGIC, _VERSION):
        raise ValueError("it begins otherwise")
    views = _Unpickler(file).load()
    values: dict[str, Tensor] = {}
    for key in _Unpickler(file).load():
        count = int(np.frombuffer(_bytes(file, 8), "<i8")[0])
        values[key] = np.frombuffer(_bytes(file, 4 * count), "<f4")
    if isinstance(views, dict) and list(views) == ["params"]:
        views = views["params"]
    if not isinstance(views, dict) or not all(isinstance(v, _View) for v in views.values()):
        raise ValueError("it is no dictionary of arrays")
    return {str(name): view.of(values[view.storage.key]) for name, view in views.items()}


def _bytes(file: IO[bytes], count: int) -> bytes:
    found = file.read(count)
    if len(found) != count:
        raise EOFError("it ends too early")
    return found
