"""How much memory a run needs, and how much there is: said before the work begins.

A reconstruction holds some forty images of the size of the module image. Where they do not fit, a
machine swaps for hours or the system ends the program; a sentence is better.
"""

from __future__ import annotations

import ctypes
import os
import re
import sys
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from pv_inspect.errors import InspectionError
from pv_inspect.geometry.grid import HrGrid
from pv_inspect.geometry.layout import ModuleLayout
from pv_inspect.observation.motion_blur import samples_of
from pv_inspect.sequence.sequence import cached_frames

__all__ = [
    "available_bytes",
    "expected_grid",
    "need_memory",
    "needed_bytes",
    "release",
    "require_memory",
]

Array = NDArray[np.float64]

# Fitted to the peaks of runs of 8 frames with 0.33 and 1.3 million pixels and module images of 3.5
# and 14 million, and of 100 frames with 0.33 million: 0.97 to 1.07 of what was measured
# (benchmarks/large_inputs.py); larger ones are extrapolated. The libraries; per pixel of a frame
# (rays, poses); per HR pixel (stencil, solver, support).
_LIBRARIES = 300 * 2**20
_PER_LR_PIXEL = 70
_PER_HR_PIXEL = 155
# The cache of frames, per pixel and frame.
_PER_CACHED_PIXEL = 5
# Positions of the pixels of a frame with motion blur, per pixel on the module.
_PER_MOVING_PIXEL = 40
# The window for the PSF is looked for at this magnification whatever is wanted.
_PSF_MAGNIFICATION, _PER_PSF_PIXEL = 4.0, 22
# Registration, per pixel of a frame: rays and their derivation, images of the module.
_PER_REGISTERED_PIXEL = 310
# Whatever else grows with the number of frames, bytes: the details of their cells, records, and
# what the allocator does not get back.
_PER_FRAME = 400_000
# Motion blur is looked for in so many frames at a time, rectified at this magnification.
_MOTION_FRAMES, _MOTION_MAGNIFICATION, _PER_RECTIFIED_PIXEL = 24, 1.5, 4
# The sensor: its residuals in bands of 16 rows, five sums of 4 bytes, per frame and pixel; sums
# over the frames, per pixel of a frame; the equations of the first look, per HR pixel.
_PER_BAND_PIXEL, _PER_SUMMED_PIXEL, _PER_LOOK_PIXEL = 5 * 4 / 16, 120, 80
# What every frame shows of the windows in which lambda is chosen, bytes: three windows of 48 LR px
# and a rim, intensities and weights, split, and the places of a fifth of the pixels for two PSFs.
_PER_VIEW = 3 * 58**2 * 34
_GIB = 2.0**30
# Bright: this share of the way from the dark to the bright pixels of a frame.
_BRIGHT = 0.3
# A limit of a control group that says "none".
_UNLIMITED = 2**60


def needed_bytes(
    shape: tuple[int, int], n_frames: int, grid: HrGrid, motion: Array | None = None
) -> float:
    """Estimate the largest memory that a run takes, libraries included.

    Parameters
    ----------
    shape : (height, width)
        Of a frame.
    n_frames : int
        Frames are read again when they are needed, but something is kept of each.
    grid : HrGrid
        Of the module image.
    motion : (n_frames, 2) float64, optional
        Path of every frame during its exposure, LR px, once it is known: of frames with motion blur
        all positions are kept.

    Returns
    -------
    float
        Bytes.
    """
    lr_pixels = float(shape[0] * shape[1])
    lr_kept = _PER_LR_PIXEL + _PER_CACHED_PIXEL * cached_frames(n_frames, shape)
    hr_pixels = float(grid.shape[0] * grid.shape[1])
    psf_pixels = hr_pixels * (_PSF_MAGNIFICATION / grid.magnification) ** 2
    paths = np.zeros((0, 2)) if motion is None else motion
    n_moving = sum(samples_of(path, grid.magnification) > 1 for path in paths)
    moving = _PER_MOVING_PIXEL * n_moving * hr_pixels / grid.magnification**2
    rectified = hr_pixels * (_MOTION_MAGNIFICATION / grid.magnification) ** 2
    stages = {
        "registration": _PER_REGISTERED_PIXEL * lr_pixels + (lr_kept - _PER_LR_PIXEL) * lr_pixels,
        "motion": lr_kept * lr_pixels
        + _PER_RECTIFIED_PIXEL * min(n_frames, _MOTION_FRAMES) * rectified,
        "sensor": (lr_kept + _PER_SUMMED_PIXEL + _PER_BAND_PIXEL * n_frames) * lr_pixels
        + _PER_LOOK_PIXEL * hr_pixels
        + moving,
        "psf": lr_kept * lr_pixels + _PER_PSF_PIXEL * psf_pixels,
        "lambda": lr_kept * lr_pixels + _PER_LOOK_PIXEL * hr_pixels + _PER_VIEW * n_frames + moving,
        "image": lr_kept * lr_pixels + _PER_HR_PIXEL * hr_pixels + moving,
    }
    return _LIBRARIES + _PER_FRAME * n_frames + max(stages.values())


def expected_grid(frame: NDArray[np.float32], layout: ModuleLayout, magnification: float) -> HrGrid:
    """Estimate the size of the module image before the module is found: by what is bright.

    Parameters
    ----------
    frame : (height, width) float32
    layout : ModuleLayout
    magnification : float
    """
    step = max(1, int(np.sqrt(frame.size / 2**18)))
    small = cv2.blur(np.ascontiguousarray(frame[::step, ::step]), (5, 5))
    dark, bright = np.percentile(small, [1.0, 99.0])
    share = float((small > dark + _BRIGHT * (bright - dark)).mean())
    unit = float(np.sqrt(share * frame.size / (layout.size[0] * layout.size[1])))
    return HrGrid.covering(layout, max(unit, 1e-3), magnification)


def need_memory(
    frame: NDArray[np.float32], n_frames: int, layout: ModuleLayout, magnification: float
) -> None:
    """Refuse work that will not fit into memory, before the module is found.

    Parameters
    ----------
    frame, layout, magnification
        See `expected_grid`.
    n_frames : int
        See `needed_bytes`.

    Raises
    ------
    InspectionError
        As `require_memory`.
    """
    height, width = frame.shape
    require_memory((height, width), n_frames, expected_grid(frame, layout, magnification))


def require_memory(
    shape: tuple[int, int], n_frames: int, grid: HrGrid, motion: Array | None = None
) -> None:
    """Refuse work that does not fit into memory.

    Parameters
    ----------
    shape, n_frames, grid, motion
        See `needed_bytes`.

    Raises
    ------
    InspectionError
        With what is needed, what is there, and the magnification that would fit.
    """
    free = available_bytes()
    if free is None:
        return
    free += _taken_bytes()
    needed = needed_bytes(shape, n_frames, grid, motion)
    if needed <= free:
        return
    scale = grid.pixels_per_unit / grid.magnification
    advice = "use a machine with more memory, fewer frames or frames of fewer pixels"
    for step in range(int(10 * grid.magnification) - 1, 9, -1):
        smaller = HrGrid.covering(grid.layout, scale, step / 10)
        if needed_bytes(shape, n_frames, smaller, motion) <= free:
            advice = f"lower the magnification to {step / 10:g}"
            break
    raise InspectionError(
        f"This run needs about {needed / _GIB:.1f} GiB of memory, {free / _GIB:.1f} GiB are free "
        f"({n_frames} frames of {shape[1]} x {shape[0]}, module image of {grid.shape[1]} x "
        f"{grid.shape[0]} at magnification {grid.magnification:.1f}): {advice}, or close other "
        "programs."
    )


def release() -> None:
    """Hand free pages back to the system, in a few milliseconds.

    glibc keeps what was freed between pieces that live on, frames in the cache above all: pass
    after pass over many frames the process would grow. Other systems hand it back by themselves.
    """
    if sys.platform == "linux":
        trim = getattr(ctypes.CDLL(None), "malloc_trim", None)
        if trim is not None:
            trim(0)


def available_bytes() -> int | None:
    """Return how much memory this process may still take; None if the system does not say.

    The least of what the machine has free (swap included), what the control group of a container
    leaves, and what resource limits (``ulimit -v``, ``ulimit -d``) leave.
    """
    known = [
        free for free in (_machine_bytes(), _group_bytes(), _limit_bytes()) if free is not None
    ]
    return max(min(known), 0) if known else None


def _machine_bytes() -> int | None:
    text = _read(Path("/proc/meminfo"))
    if text:
        sizes = {m[1]: int(m[2]) * 1024 for m in re.finditer(r"(\w+):\s+(\d+) kB", text)}
        if "MemAvailable" in sizes:
            return sizes["MemAvailable"] + sizes.get("SwapFree", 0)
    if sys.platform == "win32":
        return _windows_bytes()
    try:  # of macOS the whole memory is known; what others hold of it gives way or is compressed
        return os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    except (ValueError, OSError, AttributeError):
        return None


def _windows_bytes() -> int | None:
    class Status(ctypes.Structure):
        _fields_ = [
            ("length", ctypes.c_uint32),
            ("load", ctypes.c_uint32),
            *[(name, ctypes.c_uint64) for name in ("total", "free", "total_page", "free_page")],
            *[(name, ctypes.c_uint64) for name in ("total_virtual", "free_virtual", "extended")],
        ]

    status = Status()
    status.length = ctypes.sizeof(Status)
    kernel = getattr(ctypes, "windll").kernel32  # noqa: B009  # not there on other systems
    return int(status.free_page) if kernel.GlobalMemoryStatusEx(ctypes.byref(status)) else None


def _group_bytes(
    root: Path = Path("/sys/fs/cgroup"), own: Path = Path("/proc/self/cgroup")
) -> int | None:
    """What the control groups of a container leave, versions 2 and 1."""
    free: list[int] = []
    for line in _read(own).splitlines():
        _, controllers, path = line.split(":", 2)
        if controllers not in ("", "memory") and "memory" not in controllers.split(","):
            continue
        base = root / "memory" if controllers else root
        limit_name = "memory.limit_in_bytes" if controllers else "memory.max"
        used_name = "memory.usage_in_bytes" if controllers else "memory.current"
        group = base / path.strip("/")
        for folder in (group, *group.parents):
            limit, used = _number(folder / limit_name), _number(folder / used_name)
            if limit is not None and used is not None and limit < _UNLIMITED:
                # The cache of files gives way.
                cache = re.search(r"^inactive_file (\d+)", _read(folder / "memory.stat"), re.M)
                free.append(limit - used + (int(cache[1]) if cache else 0))
            if folder == base:
                break
    return min(free, default=None)


def _limit_bytes() -> int | None:
    if sys.platform == "win32":
        return None
    import resource

    status = _read(Path("/proc/self/status"))
    free = []
    for limit, name in ((resource.RLIMIT_AS, "VmSize"), (resource.RLIMIT_DATA, "VmData")):
        soft, _ = resource.getrlimit(limit)
        held = re.search(rf"^{name}:\s+(\d+) kB", status, re.M)
        if soft != resource.RLIM_INFINITY and held:
            free.append(soft - int(held[1]) * 1024)
    return min(free, default=None)


def _taken_bytes() -> int:
    """Memory that this process holds already."""
    held = re.search(r"^VmRSS:\s+(\d+) kB", _read(Path("/proc/self/status")), re.M)
    return int(held[1]) * 1024 if held else 0


def _number(path: Path) -> int | None:
    text = _read(path).strip()
    return int(text) if text.isdecimal() else None


def _read(path: Path) -> str:
    try:
        return path.read_text(encoding="ascii", errors="replace")
    except OSError:
        return ""
