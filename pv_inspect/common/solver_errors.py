"""What goes wrong inside of solvers and libraries, in words for the user."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import cv2
import numpy as np

from pv_inspect.errors import InspectionError

__all__ = ["NUMERICAL", "explained_errors"]

NUMERICAL = (np.linalg.LinAlgError, cv2.error, FloatingPointError, OverflowError, ZeroDivisionError)
"""What libraries raise when numbers do not determine what is asked for."""


@contextmanager
def explained_errors(stage: str) -> Iterator[None]:
    """Turn what a solver raises while a stage works into one sentence.

    Parameters
    ----------
    stage : str
        Name of the stage.

    Raises
    ------
    InspectionError
        Where a solver failed; its own exception is the cause.
    MemoryError
        Also where a library has an exception of its own for it.
    """
    try:
        yield
    except cv2.error as error:
        if error.code == cv2.Error.StsNoMem or "bad_alloc" in str(error):
            raise MemoryError(str(error)) from error
        raise InspectionError(_sentence(stage, error)) from error
    except NUMERICAL as error:
        raise InspectionError(_sentence(stage, error)) from error


def _sentence(stage: str, error: Exception) -> str:
    # OpenCV puts file and line of its own source first.
    said = str(getattr(error, "err", "") or error).split("\n")[0].rstrip(". ")[:80] or "no reason"
    return (
        f"The frames do not determine what the stage {stage!r} has to find ({said}): "
        "check rows, cols and given camera values, and leave out frames that show the module badly."
    )
