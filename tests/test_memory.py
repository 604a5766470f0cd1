from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from pv_inspect import memory
from pv_inspect.errors import InspectionError
from pv_inspect.geometry.grid import HrGrid
from pv_inspect.geometry.layout import ModuleLayout
from pv_inspect.memory import available_bytes, expected_grid, need_memory, needed_bytes
from pv_inspect.sequence.sequence import cached_frames

LAYOUT = ModuleLayout(6, 10)
SHAPE = (3000, 4096)
GIB = 2.0**30


def grid(magnification: float) -> HrGrid:
    return HrGrid.covering(LAYOUT, 370.0, magnification)


def test_the_module_image_decides_at_high_magnification() -> None:
    few, many = (needed_bytes(SHAPE, 8, grid(m)) for m in (3.0, 6.0))
    assert 3.5 < many / few < 4.0


def test_frames_with_motion_blur_keep_their_positions() -> None:
    still, moving = np.zeros((20, 2)), np.full((20, 2), 3.0)
    known = needed_bytes(SHAPE, 20, grid(2.0), still)
    assert known == needed_bytes(SHAPE, 20, grid(2.0))
    assert needed_bytes(SHAPE, 20, grid(2.0), moving) > known + 4e9


def test_something_is_kept_of_every_frame() -> None:
    small = HrGrid.covering(LAYOUT, 58.0, 2.0)
    needed = [needed_bytes((512, 640), n, small) for n in (8, 64, 300, 3000)]
    assert needed == sorted(needed)
    # The sums in bands of every frame, 1.25 bytes a pixel, and what does not go with its pixels.
    assert needed[-1] - needed[-2] == pytest.approx(2700 * (1.25 * 512 * 640 + 4e5), rel=0.01)


def test_large_sequences_are_refused_by_the_number_of_their_frames(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(memory, "available_bytes", lambda: int(10 * GIB))
    monkeypatch.setattr(memory, "_taken_bytes", lambda: 0)
    memory.require_memory(SHAPE, 20, grid(2.0))
    with pytest.raises(InspectionError, match=r"needs about \d+\.\d GiB .* \(2000 frames of"):
        memory.require_memory(SHAPE, 2000, grid(2.0))


def test_the_size_of_the_module_image_is_seen_in_a_frame() -> None:
    frame = np.full((512, 640), 0.02, np.float32)
    frame[100:400, 70:570] = 0.6
    expected = HrGrid.covering(LAYOUT, 50.0, 4.0)
    assert np.prod(expected_grid(frame, LAYOUT, 4.0).shape) == pytest.approx(
        np.prod(expected.shape), rel=0.1
    )


@pytest.mark.parametrize("frame", [np.zeros((64, 80)), np.ones((64, 80))], ids=["black", "white"])
def test_a_frame_without_a_module_needs_some_memory(frame: np.ndarray) -> None:
    assert expected_grid(frame.astype(np.float32), LAYOUT, 4.0).shape[0] > 0


def test_what_does_not_fit_is_refused_with_the_magnification_that_does(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(memory, "available_bytes", lambda: int(6 * GIB))
    monkeypatch.setattr(memory, "_taken_bytes", lambda: 0)
    with pytest.raises(
        InspectionError, match=r"needs about 2\d\.\d GiB .* 6\.0 GiB are free"
    ) as no:
        memory.require_memory(SHAPE, 8, grid(4.0))
    advised = float(str(no.value).split("lower the magnification to ")[1].split(",")[0])
    memory.require_memory(SHAPE, 8, grid(advised))
    with pytest.raises(InspectionError):
        memory.require_memory(SHAPE, 8, grid(advised + 0.2))
    assert len(str(no.value)) < 380


def test_where_no_magnification_fits_that_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(memory, "available_bytes", lambda: int(0.2 * GIB))
    monkeypatch.setattr(memory, "_taken_bytes", lambda: 0)
    with pytest.raises(InspectionError, match="use a machine with more memory"):
        need_memory(np.ones(SHAPE, np.float32), 8, LAYOUT, 4.0)


def test_a_system_that_says_nothing_is_believed_to_have_enough(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(memory, "available_bytes", lambda: None)
    memory.require_memory(SHAPE, 8, grid(6.0))


def test_the_group_of_a_container_limits_memory_its_file_cache_does_not(tmp_path: Path) -> None:
    own = tmp_path / "cgroup"
    group = tmp_path / "root" / "a" / "b"
    group.mkdir(parents=True)
    own.write_text("0::/a/b\n")
    (group / "memory.max").write_text("max\n")
    (group / "memory.current").write_text("500\n")
    (group.parent / "memory.max").write_text("4000\n")
    (group.parent / "memory.current").write_text("3000\n")
    (group.parent / "memory.stat").write_text("anon 1\ninactive_file 700\n")
    assert memory._group_bytes(tmp_path / "root", own) == 1700


def test_groups_of_the_older_kind_count_too(tmp_path: Path) -> None:
    own = tmp_path / "cgroup"
    group = tmp_path / "root" / "memory"
    group.mkdir(parents=True)
    own.write_text("5:cpu:/x\n4:memory:/not/mounted/here\n")
    (group / "memory.limit_in_bytes").write_text("1000\n")
    (group / "memory.usage_in_bytes").write_text("400\n")
    assert memory._group_bytes(tmp_path / "root", own) == 600
    (group / "memory.limit_in_bytes").write_text(f"{2**63 - 4096}\n")
    assert memory._group_bytes(tmp_path / "root", own) is None


@pytest.mark.skipif(sys.platform != "linux", reason="reads /proc")
def test_a_resource_limit_is_seen() -> None:
    code = (
        "import resource\n"
        "from pv_inspect.memory import available_bytes\n"
        "resource.setrlimit(resource.RLIMIT_DATA, (3 * 2**30, resource.RLIM_INFINITY))\n"
        "print(available_bytes())"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert 0 < int(done.stdout) < 3 * 2**30
    assert available_bytes() is not None


def test_frames_that_do_not_fit_into_the_cache_do_not_fill_it() -> None:
    assert [cached_frames(n, (512, 640)) for n in (8, 64, 65, 300)] == [8, 64, 8, 8]
    assert [cached_frames(n, SHAPE) for n in (1, 2, 20)] == [1, 2, 2]
