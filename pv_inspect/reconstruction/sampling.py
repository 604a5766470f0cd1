"""How far the frames together sample the module more finely than one of them.

One frame takes one sample per LR pixel: detail that is finer than its pixels is in it, but folded
onto coarser detail. Frames that see the module displaced by parts of a pixel fold it with other
phases, and only that tells the two apart. Without it nothing in the frames speaks against a wrong
PSF or a weak prior either: a change of the scene makes good for both.
"""

from __future__ import annotations

import numpy as np

from pv_inspect.registration.registration import Registration

__all__ = ["FEW", "STILL", "between", "of_more_than_one", "sampling_of"]

STILL = 0.05
"""Sampling below which frames stand in one place: registered to 0.02 px they reach so much."""

FEW = 0.2
"""Sampling below which a user is told that detail is hardly finer than in one frame: 2 frames have
0.15 at most, 3 at random places 0.23 in 95 of 100 draws."""

# What an LR pixel folds onto a detail: itself, and its neighbours along both axes in steps of one
# cycle per LR pixel. Those on the diagonals lie beyond what optics and aperture let through.
_ALIASES = np.array([[0, 0], [1, 0], [-1, 0], [0, 1], [0, -1]], np.float64)
# A pattern counts half if the frames contain it with this share of the power that it has if they
# stand everywhere between the pixels, in one frame at least.
_FAINT = 0.1
# Sampling of two frames, half a pixel apart along both axes.
_TWO = 0.12
# Share of the patterns from which on the frames alone decide. Estimated from 4 frames a PSF may
# still be far too wide: 4 frames of 8 simulated modules (seeds 20 to 27 of
# `benchmarks/few_frames.py`) gave 0.3 dB more on average with a share of 1 than with 0.8, between
# -0.6 and +2.0. With 12 frames at random places the sampling is over 0.99 in 95 of 100 draws.
_ENOUGH = 0.95


def sampling_of(registration: Registration, shape: tuple[int, int]) -> float:
    """Say how well the frames in use tell detail from what it is folded onto.

    Parameters
    ----------
    registration : Registration
    shape : tuple of int
        (height, width) of a frame.

    Returns
    -------
    float
        0 for one frame, and for any number of frames that all stand in the same place; 1 from about
        ten frames at random places on. Two frames reach 0.15 at most, four 0.7. Frames that should
        stand still, registered to 0.01 px, stay below 0.01.

    Notes
    -----
    At the centre of every cell, frame i with the LR pixel position u_i makes of the five aliases k
    the sum with the factors ``exp(2 pi i k u_i)``. With the eigenvalues m of their 5 x 5 Gram
    matrix, which are 1 for a pattern in one frame and n / 5 for all patterns if n frames are spread
    evenly, ``sum m / (m + 0.1 max(1, n / 5))`` counts the independent patterns that the frames
    contain. Their mean over the cells, x from 0 for one pattern to 1 for 0.95 of all, counts
    as ``x^2 (3 - 2 x)``.
    """
    layout, camera = registration.layout, registration.camera
    used = np.flatnonzero(registration.used)
    if used.size < 2:
        return 0.0
    centres = layout.cell_centres()
    px = np.array([camera.project(registration.homographies[i], centres) for i in used])
    limit = np.array(shape[::-1]) - 1.0
    seen = (np.isfinite(px) & (px >= 0.0) & (px <= limit)).all(axis=-1)
    phase = 2.0 * np.pi * np.where(seen[..., None], px, 0.0) @ _ALIASES.T
    factors = np.where(seen[..., None], np.exp(1j * phase), 0.0)
    gram = np.einsum("ipk,ipl->pkl", factors.conj(), factors) / len(_ALIASES)
    power = np.maximum(np.linalg.eigvalsh(gram), 0.0)
    faint = _FAINT * np.maximum(1.0, seen.sum(axis=0) / len(_ALIASES))[:, None]
    patterns = (power / (power + faint)).sum(axis=-1)[seen.any(axis=0)]
    if not patterns.size:
        return 0.0
    # More than one pattern, of the most that there can be.
    all_but_one = _ENOUGH * len(_ALIASES) / (1.0 + _FAINT) - 1.0
    x = float(np.clip((patterns.mean() - 1.0) / all_but_one, 0.0, 1.0))
    return x * x * (3.0 - 2.0 * x)


def of_more_than_one(sampling: float) -> float:
    """Share of what seems to be finer detail that is not the coarse detail of one frame, folded.

    Parameters
    ----------
    sampling : float
        See `sampling_of`.

    Returns
    -------
    float
        0 for one place between the pixels, 1 from two on that lie half a pixel apart.
    """
    return min(1.0, sampling / _TWO)


def between(usual: float, found: float, sampling: float) -> float:
    """Mix what is usual with what the frames say, as far as they can say it.

    Parameters
    ----------
    usual, found : float
        Both positive.
    sampling : float
        See `sampling_of`: 0 takes what is usual, 1 what was found.

    Returns
    -------
    float
        In between, in equal ratios.
    """
    return found if sampling >= 1.0 else float(usual * (found / usual) ** sampling)
