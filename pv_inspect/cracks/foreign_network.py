"""A network of somebody else, run in a process of its own.

What executes ONNX files trusts them: one altered number can end the process. No check of the file
finds all of those, so networks that are not ours never run in this process.
"""

from __future__ import annotations

import contextlib
import signal
import struct
import subprocess
import sys
import weakref
from dataclasses import dataclass
from pathlib import Path
from threading import Timer
from typing import IO

import numpy as np
from numpy.typing import NDArray

from pv_inspect.errors import InspectionError

__all__ = ["NetworkApart", "Purpose"]

Image = NDArray[np.float32]

_PROGRAM = Path(__file__).with_name("foreign_network_process.py")
# Eight cells take half a second of our own network; a loaded machine is a hundred times slower.
LONGEST_S = 60.0
_MOST_AXES, _MOST_VALUES = 8, 2**28


@dataclass(frozen=True)
class Purpose:
    """What a network is for: the words of sentences, and how long a call may take.

    Parameters
    ----------
    name : str
        With an article.
    inputs : str
        What it is given.
    instead : str
        What to do if it can't be used.
    longest_s : float or None
        `LONGEST_S` if None.
    """

    name: str = "a crack model"
    inputs: str = "cells (n, 1, h, w) float32"
    instead: str = "give a model of pv_inspect.cracks.training.train"
    longest_s: float | None = None


class NetworkApart:
    """Network that runs in a process of its own, which ends with this object.

    Parameters
    ----------
    path : Path
        For sentences.
    network : bytes
        The ONNX file.
    purpose : Purpose
    """

    def __init__(self, path: Path, network: bytes, purpose: Purpose | None = None) -> None:
        self._path = path
        self._for = purpose or Purpose()
        try:
            # Its own folder is not searched for modules: names there are those of the package.
            self._process = subprocess.Popen(
                [sys.executable, "-P", str(_PROGRAM)],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=subprocess.DEVNULL,
            )
        except OSError as error:
            raise InspectionError(
                f"{path} is not one of our models and needs a process of its own, which can't be "
                f"started ({error.strerror}): close other programs, or use our own model."
            ) from None
        self._end = weakref.finalize(self, _ended, self._process)
        self._begun = struct.pack("<Q", len(network)) + network

    def forward(self, given: Image) -> Image:
        """Run the network.

        Parameters
        ----------
        given : float32
            Of any shape.

        Returns
        -------
        float32
            What the network returns, of any shape.

        Raises
        ------
        InspectionError
            If it can't be run, takes too long, or has ended its process.
        """
        source, target = self._process.stdin, self._process.stdout
        assert source is not None
        assert target is not None
        longest_s = LONGEST_S if self._for.longest_s is None else self._for.longest_s
        late = Timer(longest_s, self._process.kill)
        late.daemon = True
        late.start()
        try:
            source.write(self._begun + struct.pack(f"<{given.ndim + 1}I", given.ndim, *given.shape))
            source.write(np.ascontiguousarray(given, np.float32).tobytes())
            source.flush()
            self._begun = b""
            return _answer(target)
        except _RefusedError as error:
            raise InspectionError(
                f"{self._path} can't be used as {self._for.name} ({error}): its input must be "
                f"{self._for.inputs}; {self._for.instead}."
            ) from None
        except (OSError, EOFError, ValueError):
            was_late = not late.is_alive()
            how = f"takes over {longest_s:g} s" if was_late else self._why_it_ended()
            raise InspectionError(
                f"{self._path} {how}, so that it can't be used as {self._for.name}: "
                f"{self._for.instead}, or leave out --model."
            ) from None
        finally:
            late.cancel()

    def close(self) -> None:
        """End the process."""
        self._end()

    def _why_it_ended(self) -> str:
        self._end()
        code = self._process.returncode
        if code is not None and code < 0:
            try:
                name = signal.Signals(-code).name
            except ValueError:
                name = f"signal {-code}"
            return f"ends the process that runs it ({name})"
        return "ends the process that runs it"


class _RefusedError(Exception):
    """What the network's process said instead of an answer."""


def _answer(target: IO[bytes]) -> Image:
    (n_axes,) = struct.unpack("<I", _read(target, 4))
    if n_axes == 0:
        (n_bytes,) = struct.unpack("<I", _read(target, 4))
        said = _read(target, min(n_bytes, 4000)).decode(errors="replace")
        raise _RefusedError(" ".join(said.rpartition("error:")[2].split()))
    if n_axes > _MOST_AXES:
        raise _RefusedError(f"it returns {n_axes} axes")
    shape = struct.unpack(f"<{n_axes}Q", _read(target, 8 * n_axes))
    n_values = 1
    for length in shape:
        n_values *= length
    if n_values > _MOST_VALUES:
        raise _RefusedError(f"it returns {shape}")
    return np.frombuffer(_read(target, 4 * n_values), np.float32).reshape(shape).copy()


def _read(source: IO[bytes], n: int) -> bytes:
    data = source.read(n)
    if len(data) < n:
        raise EOFError
    return data


def _ended(process: subprocess.Popen[bytes]) -> None:
    for stream in (process.stdin, process.stdout):
        if stream is not None:
            with contextlib.suppress(OSError, ValueError):
                stream.close()
    try:
        process.wait(1.0)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()
