"""The process in which a network of somebody else runs.

Started by `pv_inspect.cracks.foreign_network`.

It reads batches from its standard input and writes answers to its standard output, each with the
number of its axes, their lengths, and float32 values. An answer with no axes is a text: an error.
Nothing of the package is imported, so that it starts quickly.
"""

from __future__ import annotations

import struct
import sys
from typing import BinaryIO

import cv2
import numpy as np
from numpy.typing import NDArray

# Ours takes less than 1 GiB for eight cells; address space is more than memory.
_MOST_BYTES = 8 * 2**30


def _limit() -> None:
    """Keep a network that asks for endless memory from taking that of others."""
    try:
        import resource
    except ImportError:  # not there on every system
        return
    _, hard = resource.getrlimit(resource.RLIMIT_AS)
    most = _MOST_BYTES if hard == resource.RLIM_INFINITY else min(hard, _MOST_BYTES)
    resource.setrlimit(resource.RLIMIT_AS, (most, hard))


def _read(source: BinaryIO, n: int) -> bytes:
    data = source.read(n)
    if len(data) < n:  # the other side has gone
        sys.exit(0)
    return data


def _answer(values: NDArray[np.float32]) -> bytes:
    return struct.pack(f"<I{values.ndim}Q", values.ndim, *values.shape) + values.tobytes()


def _refusal(text: str) -> bytes:
    said = text.encode()[:4000]
    return struct.pack("<II", 0, len(said)) + said


def main(source: BinaryIO, target: BinaryIO) -> None:
    """Answer batches until there are no more."""
    _limit()
    (n_bytes,) = struct.unpack("<Q", _read(source, 8))
    network = np.frombuffer(_read(source, n_bytes), np.uint8)
    net = None
    while True:
        (n_axes,) = struct.unpack("<I", _read(source, 4))
        shape = struct.unpack(f"<{n_axes}I", _read(source, 4 * n_axes))
        given = np.frombuffer(_read(source, 4 * int(np.prod(shape))), np.float32).reshape(shape)
        try:
            if net is None:
                net = cv2.dnn.readNetFromONNX(network)
            net.setInput(np.ascontiguousarray(given))
            answer = _answer(np.ascontiguousarray(net.forward(), np.float32))
        except (cv2.error, MemoryError, ValueError, TypeError) as error:
            answer = _refusal(str(error) or type(error).__name__)
        target.write(answer)
        target.flush()


if __name__ == "__main__":
    main(sys.stdin.buffer, sys.stdout.buffer)
