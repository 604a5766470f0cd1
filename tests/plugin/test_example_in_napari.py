"""The notebook that opens napari, in a real window: `make test-core` runs it without one."""

from __future__ import annotations

import base64
from pathlib import Path

import cv2
import numpy as np
import pytest

from tests.notebooks import executed, shown

pytestmark = pytest.mark.xvfb


@pytest.mark.slow
def test_the_notebook_embeds_a_screenshot_of_its_result_in_napari(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setenv("IPYTHONDIR", str(tmp_path / "ipython"))
    (picture,) = shown(executed("03_folder_to_report.ipynb"), "image/png")
    window = cv2.imdecode(np.frombuffer(base64.b64decode(picture), np.uint8), cv2.IMREAD_COLOR)
    height, width = window.shape[:2]
    canvas = window[height // 3 : -height // 3, width // 2 : -width // 5]
    assert canvas.mean() > 60, "the module is not black"
    assert canvas.std() > 15, "and shows its cells"
