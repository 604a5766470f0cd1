"""What a scientist types, and what importing the package does: nothing."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import pv_inspect

README = Path(__file__).parents[1] / "README.md"


def test_every_public_name_is_there() -> None:
    for name in pv_inspect.__all__:
        assert getattr(pv_inspect, name) is not None
    assert set(pv_inspect.__all__) <= set(dir(pv_inspect))
    with pytest.raises(AttributeError, match="has no attribute 'Sequence'"):
        pv_inspect.Sequence  # noqa: B018


def test_the_snippet_runs_as_it_is_written(
    quick_folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "folder").symlink_to(quick_folder, target_is_directory=True)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("MPLBACKEND", "agg")
    import pv_inspect as pv

    frames = pv.open_sequence("folder")
    inspection = pv.inspect(frames, pv.Settings(magnification=3))
    assert inspection.complete
    kinds = set()
    for step in pv.inspect_steps(frames, start=inspection):
        kinds.add(type(step).__name__)
    assert kinds == {"Step"}
    pv.write_result(inspection, "out")
    again = pv.read_result("out")
    assert type(again) is type(inspection)
    np.testing.assert_array_equal(again.reconstruction.image, inspection.reconstruction.image)
    np.testing.assert_array_equal(again.tiles.pixels, inspection.tiles.pixels)
    assert pv.plots.grid(inspection) is not None
    assert pv.plots.cells(again).get_title() == pv.plots.cells(inspection).get_title()
    with pytest.raises(pv.InspectionError, match="out are not open"):
        pv.write_result(again, "again")


def test_the_readme_types_the_same_names() -> None:
    blocks = re.findall(r"```python\n(.*?)```", README.read_text("utf-8"), re.DOTALL)
    assert blocks
    typed = {name for block in blocks for name in re.findall(r"\bpv\.(\w+)", block)}
    assert {"open_sequence", "inspect", "write_result", "read_result", "plots"} <= typed
    assert typed <= set(pv_inspect.__all__)


def test_importing_the_package_changes_nothing_and_loads_next_to_nothing() -> None:
    program = (
        "import os, signal, sys\n"
        "before = dict(os.environ), [signal.getsignal(n) for n in (2, 15)], set(sys.modules)\n"
        "import pv_inspect\n"
        "assert dict(os.environ) == before[0]\n"
        "assert [signal.getsignal(n) for n in (2, 15)] == before[1]\n"
        "new = {name.split('.')[0] for name in set(sys.modules) - before[2]}\n"
        "assert not new & {'numpy', 'numba', 'cv2', 'pydantic', 'scipy', 'rich'}, new\n"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
