"""The program vidsr on one cell: its own steps in its own order, with the values it has by default.

Its command reads videos by ffmpeg, so that its functions are called with the frames instead.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from pv_inspect.errors import InspectionError
from pv_inspect.evaluation.case import Case, Cell
from pv_inspect.evaluation.frame_patches import FramePatch

__all__ = ["vidsr_image"]

Image = NDArray[np.float32]


def vidsr_image(case: Case, cell: Cell, scale: int) -> Image:
    """Make a cell from all frames, on the grid of a case.

    Parameters
    ----------
    case : Case
    cell : (row, col)
    scale : int
        By which the program enlarges.

    Returns
    -------
    (H, W) float32
        Module's intensity scale.

    Raises
    ------
    InspectionError
        If the package is not installed.
    """
    try:
        import vidsr
    except ImportError:
        raise InspectionError("vidsr is not installed: pip install 'pv-inspect[peers]'.") from None
    own = case.frame_of(cell)
    patch = FramePatch.around(case, cell, own)
    height, width = case.sequence.shape
    low = np.floor(patch.target_px.min(axis=(0, 1))).astype(int)
    side = np.ceil(patch.target_px.max(axis=(0, 1))).astype(int) + 1 - low
    roi = vidsr.clamp_rect((*low.tolist(), *side.tolist()), width, height)
    asked = vidsr.build_parser().parse_args(["sr", "frames", "--out", "none", "--clahe", "0"])
    pad = max(32, int(0.6 * max(roi[2], roi[3])))
    left, top, w, h = vidsr.even_rect(
        vidsr.expand_rect(roi, pad, pad, width, height), width, height
    )
    used = [int(i) for i in np.flatnonzero(case.registration.used)]
    white = max(patch.white, 1e-6)
    frames = []
    for i in used:
        image = case.sequence.frame(i).image[top : top + h, left : left + w]
        level = (image - case.registration.offset[i]) / (case.registration.gain[i] * white)
        frames.append(np.clip(level, 0, 1).astype(np.float32))
    inner = (roi[0] - left, roi[1] - top, roi[2], roi[3])
    made, (x, y) = _fused(vidsr, asked, frames, used.index(own), inner, scale)
    placed = replace(patch, corner_px=(left + x, top + y))
    return placed.rectified(made * np.float32(white), scale)


def _fused(
    vidsr: Any,
    asked: Any,
    frames: list[Image],
    own: int,
    roi: tuple[int, int, int, int],
    scale: int,
) -> tuple[Image, tuple[int, int]]:
    """Align, select, fuse and sharpen; returns the image and the window's pixel of its corner."""
    x, y, w, h = roi
    size = (frames[0].shape[1], frames[0].shape[0])
    mask = vidsr.build_mask(frames[0].shape, roi, asked.mask_grow)
    flat = [vidsr.prep_for_align(frame, asked.hp_sigma) for frame in frames]
    sharp = [vidsr.sharpness(frame[y : y + h, x : x + w]) for frame in frames]
    # From the reference outward: each frame begins with what its neighbour has found.
    warps: dict[int, Any] = {own: np.eye(3, dtype=np.float32)[:2]}
    for i in sorted(range(len(frames)), key=lambda i: abs(i - own))[1:]:
        found, _ = vidsr.align_frame(
            *(flat[own], flat[i], mask, asked.motion),
            *(warps.get(i - 1 if i > own else i + 1), asked.ecc_iters, asked.ecc_eps),
            margin=asked.model_margin,
        )
        warps[i] = warps[own] if found is None else found
    scores, residuals = [], []
    for i, frame in enumerate(frames):
        covered = vidsr.warp_to_ref(np.ones_like(frame), warps[i], size, cv2.INTER_NEAREST) > 0.99
        seen = (mask > 0) & covered
        enough = seen.sum() > 32
        moved = vidsr.warp_to_ref(frame, warps[i], size, cv2.INTER_LINEAR)
        moved_flat = vidsr.warp_to_ref(flat[i], warps[i], size, cv2.INTER_LINEAR)
        residuals.append(float(np.abs(moved - frames[own])[seen].mean()) if enough else 1.0)
        scores.append(vidsr.ncc(flat[own], moved_flat, seen) if enough else 0.0)
    middle = float(np.median(residuals))
    spread = 1.4826 * float(np.median(np.abs(np.array(residuals) - middle))) + 1e-6
    kept = [
        i
        for i in range(len(frames))
        if i == own
        or (scores[i] >= asked.min_ncc and residuals[i] <= middle + asked.reject_k * spread)
    ]
    placed = vidsr.expand_rect(roi, asked.out_pad, asked.out_pad, *size)
    to_hr = vidsr.hr_transform(placed, scale)
    hr_size = (placed[2] * scale, placed[3] * scale)
    colours = [np.stack([frames[i]] * 3, axis=-1) for i in kept]
    stack = []
    for i, colour in zip(kept, colours, strict=True):
        one = vidsr.warp_lr_to_hr(colour, warps[i], to_hr, hr_size, cv2.INTER_CUBIC)
        ones = np.ones_like(frames[i])
        covered = vidsr.warp_lr_to_hr(ones, warps[i], to_hr, hr_size, cv2.INTER_NEAREST)
        one[covered < 0.99] = np.nan
        stack.append(one)
    usual = float(np.median([sharp[i] for i in kept])) or 1.0
    weights = np.array(
        [max(0.05, scores[i]) * min(1.0, sharp[i] / usual) ** 0.5 for i in kept], np.float32
    )
    weights /= weights.mean()
    fused, _ = vidsr.fuse_stack(np.stack(stack), weights, asked.fusion, asked.trim)
    psf = 0.35 * scale
    found = vidsr.back_project(
        *(fused, colours, [warps[i] for i in kept], to_hr, weights, asked.ibp, psf, asked.lam),
        verbose=False,
    )
    found = vidsr.richardson_lucy(found, psf * asked.rl_psf_scale, asked.rl)
    found = vidsr.unsharp(found, max(0.6, psf * 0.7), asked.unsharp)
    return np.asarray(found.mean(axis=-1), np.float32), (placed[0], placed[1])
