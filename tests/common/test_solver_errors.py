from __future__ import annotations

import cv2
import numpy as np
import pytest

from pv_inspect.common.solver_errors import explained_errors
from pv_inspect.errors import InspectionError
from pv_inspect.geometry.grid import HrGrid
from pv_inspect.geometry.layout import ModuleLayout


def test_what_a_solver_raises_becomes_one_sentence() -> None:
    with (
        pytest.raises(InspectionError, match=r"stage 'calibrate' .*Singular matrix") as said,
        explained_errors("calibrate"),
    ):
        np.linalg.inv(np.zeros((3, 3)))
    assert isinstance(said.value.__cause__, np.linalg.LinAlgError)


def test_what_opencv_raises_is_told_without_its_source_file() -> None:
    with pytest.raises(InspectionError) as said, explained_errors("detect"):
        cv2.GaussianBlur(np.zeros((0, 0), np.float32), (0, 0), 1.0)
    assert ".cpp" not in str(said.value)
    assert len(str(said.value)) < 380


def test_opencv_without_memory_is_without_memory() -> None:
    def fails() -> None:
        error = cv2.error("Failed to allocate 99999999999 bytes")
        error.code = cv2.Error.StsNoMem
        raise error

    with pytest.raises(MemoryError), explained_errors("reconstruct"):
        fails()


def test_other_errors_are_our_own_and_stay_what_they_are() -> None:
    with pytest.raises(KeyError), explained_errors("detect"):
        raise KeyError("x")


@pytest.mark.parametrize("scale", [float("nan"), 0.0, float("inf")])
def test_a_module_without_a_size_is_refused(scale: float) -> None:
    with pytest.raises(InspectionError, match="give the module no size"):
        HrGrid.covering(ModuleLayout(2, 3), scale, 4.0)
