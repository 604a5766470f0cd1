from __future__ import annotations

import base64
from pathlib import Path
from typing import Any

import cv2
import nbformat
import numpy as np
import pytest

from tests.notebooks import EXAMPLES, executed, shown

NOTEBOOKS = sorted(path.name for path in EXAMPLES.glob("*.ipynb"))


@pytest.fixture(autouse=True)
def alone(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """No display, and nothing of the user's IPython."""
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("IPYTHONDIR", str(tmp_path / "ipython"))


@pytest.fixture
def beside_a_small_module(quick_folder: Path, tmp_path: Path) -> Path:
    """Return a folder beside a small sample; the real one is the third notebook's."""
    (tmp_path / "sample_data").mkdir()
    (tmp_path / "sample_data" / "module").symlink_to(quick_folder, target_is_directory=True)
    folder = tmp_path / "examples"
    folder.mkdir()
    return folder


def check_run(outputs: list[Any], plots: int) -> None:
    """The bar ended, the inspection showed its picture, and every plot has one."""
    pages = shown(outputs, "text/html")
    assert sum("<progress value=" in page for page in pages) == 1
    assert 'value="1.000"' in next(page for page in pages if "<progress" in page)
    assert not any(output.get("name") == "stderr" for output in outputs)
    pictures = shown(outputs, "image/png")
    assert len(pictures) == plots
    for picture in pictures:
        data = np.frombuffer(base64.b64decode(picture), np.uint8)
        assert np.ptp(cv2.imdecode(data, cv2.IMREAD_GRAYSCALE)) > 100


def test_there_are_three_notebooks_without_outputs() -> None:
    assert len(NOTEBOOKS) == 3
    for name in NOTEBOOKS:
        cells = nbformat.read(EXAMPLES / name, 4).cells
        assert not any(cell.get("outputs") or cell.get("execution_count") for cell in cells)


@pytest.mark.slow
def test_a_first_look(beside_a_small_module: Path) -> None:
    outputs = executed("01_first_look.ipynb", beside_a_small_module)
    check_run(outputs, plots=4)
    # Four frames of 30 px per cell: cracks would not show, which comes before the counts.
    (page,) = (page for page in shown(outputs, "text/html") if "In doubt:" in page)
    assert page.index("can&#39;t be judged") < page.index("none suspected, none clean")


@pytest.mark.slow
def test_tuning_kappa_and_lambda(beside_a_small_module: Path) -> None:
    outputs = executed("02_tuning_kappa_and_lambda.ipynb", beside_a_small_module)
    check_run(outputs, plots=4)
    pages = shown(outputs, "text/html")
    assert any("Still to run: register, reconstruct, cells, cracks." in page for page in pages)


@pytest.mark.slow
def test_from_a_folder_to_a_report_without_a_display() -> None:
    outputs = executed("03_folder_to_report.ipynb")
    check_run(outputs, plots=0)
    assert "There is no display" in shown(outputs, "text/markdown")[-1]
    printed = "".join(output.text for output in outputs if output.output_type == "stream")
    assert "report.html" in printed
    assert "holds no TIFF, PNG" in printed
