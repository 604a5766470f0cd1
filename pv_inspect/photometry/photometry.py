"""What lies between the light of the module and the numbers of a frame, out of the frames.

Frame i is ``(gain_i W_i f) V (1 + column gain + pixel gain) + column offsets + offset_i + noise``:
registration knows gain_i and offset_i, a first module image tells the rest.
"""

from __future__ import annotations

from collections.abc import Generator
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from pv_inspect.common.robust import MAD_TO_SIGMA
from pv_inspect.observation.model import ObservationModel
from pv_inspect.photometry.fixed_pattern import (
    ColumnPattern,
    columns_of_frames,
    fixed_columns,
    pixel_gains,
)
from pv_inspect.photometry.residual_sums import (
    COUNT,
    LIGHT,
    MISFIT,
    PRODUCT,
    ResidualSums,
    halves_along,
)
from pv_inspect.photometry.vignetting import Vignetting, estimate_vignetting
from pv_inspect.registration.light_falloff import falloff_of_parts
from pv_inspect.registration.registration import Registration
from pv_inspect.sequence.sequence import FrameSequence

__all__ = [
    "Photometry",
    "estimate_photometry",
    "falloff_alone",
    "huber_weights",
    "mean_illumination",
    "observed",
    "photometry_of",
]

Array = NDArray[np.float64]
Image = NDArray[np.float32]

# Frames that it takes to tell a pattern from the scene.
_LEAST_FRAMES = 6
# The halves of the frames must be this far apart on the sensor, LR px: what the module image gets
# wrong of the scene reaches about a pixel.
_LEAST_DISTANCE = 1.5
# Standard deviations of the residual from which on a pixel counts for less.
_HUBER = 4.0
# Noise levels that a whole frame may be off before it counts for less: with a blur that the model
# doesn't know it is 1.5, with another module in it 5 and more.
_WHOLE_FRAME = 2.0
# Gaussian that the light is smoothed with before the noise is read off it, and where it ends: not
# that of `NoiseModel.precision`, which says why.
_SMOOTH_LR_PX, _REACH = 1.0, 4
# HR pixels between the points that the mean vignetting is computed at.
_COARSE = 16


@dataclass(frozen=True, eq=False)
class Photometry:
    """The sensor's part in the intensities of all frames.

    Parameters
    ----------
    response : (height, width) float32
        What a pixel makes of the light, about 1; 0 for pixels that are not used.
    offsets : (n_frames, width) float32
        What the columns add to it in every frame, full scale = 1.
    vignetting : Vignetting
        The slow part of the response.
    illumination : (height, width) float64
        The vignetting alone, at every pixel.
    columns : ColumnPattern or None
        What was known of the columns before the frames were looked at.
    column_sums : (2, 5, width) float32 or None
        What two halves of the frames say of the columns, for `pooled_columns`; with what was taken
        out when the frames were opened. None if the sequence can't tell.
    """

    response: Image
    offsets: Image
    vignetting: Vignetting
    illumination: Array
    columns: ColumnPattern | None = None
    column_sums: Image | None = None

    @classmethod
    def ideal(cls, n_frames: int, shape: tuple[int, int]) -> Photometry:
        """Return a sensor that is the same everywhere."""
        return cls(
            np.ones(shape, np.float32),
            np.zeros((n_frames, shape[1]), np.float32),
            Vignetting(),
            np.ones(shape),
        )


def falloff_alone(sequence: FrameSequence, registration: Registration) -> Photometry | None:
    """Return what the registration took out of frames that show different parts; None if nothing.

    Parameters
    ----------
    sequence : FrameSequence
    registration : Registration
    """
    found = falloff_of_parts(sequence, registration)
    if found is None:
        return None
    return photometry_of(Vignetting(found.coefficients, found.deviations), sequence, registration)


def photometry_of(
    vignetting: Vignetting, sequence: FrameSequence, registration: Registration
) -> Photometry:
    """Return a sensor of which the vignetting alone is known.

    Parameters
    ----------
    vignetting : Vignetting
    sequence : FrameSequence
    registration : Registration
        Its camera says where the principal point is.
    """
    light = vignetting.illumination(registration.camera, sequence.shape)
    ideal = Photometry.ideal(len(sequence), sequence.shape)
    return replace(
        ideal, response=light.astype(np.float32), vignetting=vignetting, illumination=light
    )


def observed(
    sequence: FrameSequence,
    registration: Registration,
    frame: int,
    photometry: Photometry | None = None,
    part: tuple[slice, slice] | None = None,
) -> tuple[Image, Image]:
    """Map a frame to the module's intensities.

    Parameters
    ----------
    sequence : FrameSequence
    registration : Registration
    frame : int
    photometry : Photometry, optional
        The sensor's part; an ideal one if not given.
    part : [row, col] slices with a start and a stop, optional
        Where in the frame; everywhere if not given.

    Returns
    -------
    g : (height, width) float32
        ``(image - offset - offsets) / (gain response)``.
    weights : (height, width) float32
        1 / variance of g; 0 for pixels that are not valid.
    """
    ready = sequence.frame(frame)
    rows, cols = part or (slice(0, ready.image.shape[0]), slice(0, ready.image.shape[1]))
    g = ready.image[rows, cols] - np.float32(registration.offset[frame])
    scale = np.full(g.shape, registration.gain[frame], np.float32)
    if photometry is not None:
        g -= photometry.offsets[frame, cols]
        scale *= photometry.response[rows, cols]
    # The variance follows the light, not the pixel's own noise.
    top, left = max(rows.start - _REACH, 0), max(cols.start - _REACH, 0)
    around = ready.image[top : rows.stop + _REACH, left : cols.stop + _REACH]
    smooth = cv2.GaussianBlur(around, (2 * _REACH + 1, 2 * _REACH + 1), _SMOOTH_LR_PX)
    smooth = smooth[rows.start - top :, cols.start - left :][: g.shape[0], : g.shape[1]]
    added = ready.added_variance
    sigma = sequence.noise.sigma(smooth, None if added is None else added[rows, cols])
    weights = np.square(scale / sigma)
    weights[~ready.valid[rows, cols]] = 0.0
    g = np.divide(g, scale, out=np.zeros_like(g), where=scale > 0)
    return g.astype(np.float32), weights.astype(np.float32)


def huber_weights(g: Image, predicted: Image, weights: Image) -> Image:
    """Lower the weights of pixels that contradict the module image.

    Parameters
    ----------
    g, predicted : (height, width) float32
    weights : (height, width) float32
        1 / variance.

    Returns
    -------
    (height, width) float32

    Notes
    -----
    ``w min(1, k / |z|) min(1, 2 / s)^2``, z = (g - predicted) sqrt(w) / max(s, 1) with s the robust
    standard deviation over the frame in units of its noise: a frame that the model fits badly as a
    whole is not full of outliers, but it is a noisier one. Pixels without a prediction (exactly 0)
    keep their weight.
    """
    z = np.abs(g - predicted) * np.sqrt(weights)
    seen = (weights > 0) & (predicted != 0)
    if not seen.any():
        return weights
    spread = MAD_TO_SIGMA * float(np.median(z[seen]))
    limit = _HUBER * max(spread, 1.0)
    share = np.where(seen, limit / np.maximum(z, limit), 1.0)
    share *= min(1.0, _WHOLE_FRAME / max(spread, 1.0)) ** 2
    return (weights * share).astype(np.float32)


def estimate_photometry(
    sequence: FrameSequence,
    registration: Registration,
    model: ObservationModel,
    image: NDArray[np.floating],
    motion: Array,
    known: Photometry | None = None,
) -> Generator[float, None, Photometry]:
    """Find the pattern and the vignetting of the sensor.

    Parameters
    ----------
    sequence : FrameSequence
    registration : Registration
    model : ObservationModel
    image : (height, width) float32
        A first HR image of the module, made without knowing them.
    motion : (n_frames, 2) float64
        Path of every frame during its exposure, LR px.
    known : Photometry, optional
        What the image was made with; an ideal sensor if not given.

    Yields
    ------
    float
        Share of the work that is done.

    Returns
    -------
    Photometry
        What was known, an ideal sensor else, as far as motion doesn't tell it from the scene.
    """
    used = np.flatnonzero(registration.used)
    ideal = known or Photometry.ideal(len(sequence), sequence.shape)
    if used.size < _LEAST_FRAMES:
        return ideal
    places = np.array([np.nanmean(registration.crossings_px(int(i)), axis=0) for i in used])
    places -= places.mean(axis=0)
    principal = np.linalg.svd(places, full_matrices=False)[2][0]
    across, apart_across = halves_along(places, np.array([1.0, 0.0]))
    along, apart_along = halves_along(places, principal)
    if apart_along < _LEAST_DISTANCE:
        return ideal
    sums = ResidualSums.empty(used.size, sequence.shape)
    blurred = model.blur.apply(image)
    for k, i in enumerate(used):
        g, weights = observed(sequence, registration, int(i), known)
        of_frame = np.float32(registration.gain[i])
        gain = of_frame if known is None else of_frame * known.response
        seen = np.asarray(
            model.frame(registration.homographies[i], motion[i]).sample(blurred), np.float32
        )
        weights = huber_weights(g, seen, weights)
        weights = np.divide(
            weights, gain**2, out=np.zeros_like(weights), where=(seen != 0) & (gain > 0)
        )
        predicted = gain * seen
        sums.add(k, bool(along[k]), predicted, gain * (g - seen), weights)
        yield (k + 1) / (used.size + 2)
    columns, gains = np.zeros((used.size, sequence.shape[1])), np.zeros(sequence.shape)
    told = None
    if apart_across > _LEAST_DISTANCE:
        if ideal.columns is None:
            told = _with_removed(sums.of_columns(across), sequence.removed_columns)
        offset, gain_of_columns = fixed_columns(sums, across, ideal.columns)
        sums.take_out_columns(offset, gain_of_columns)
        columns += offset
        gains += gain_of_columns
        of_frames = columns_of_frames(sums)
        sums.take_out_columns(of_frames, np.zeros_like(gain_of_columns))
        columns += of_frames
    gains += pixel_gains(sums)
    yield (used.size + 1) / (used.size + 2)
    vignetting = estimate_vignetting(
        sums, registration.camera, registration.homographies[used], sequence.shape
    )
    if known is not None:
        vignetting = known.vignetting.and_further(vignetting)
    illumination = vignetting.illumination(registration.camera, sequence.shape)
    offsets = ideal.offsets.copy()
    offsets[used] += columns
    pattern = ideal.response / ideal.illumination
    response = (illumination * pattern * (1.0 + gains)).astype(np.float32)
    return Photometry(response, offsets, vignetting, illumination, ideal.columns, told)


def _with_removed(sums: Array, removed: Image | None) -> Image | None:
    """Add what was taken out of the columns before to the sums over their residuals."""
    if removed is None:
        return None
    whole = sums.copy()
    whole[:, MISFIT] += removed * sums[:, COUNT]
    whole[:, PRODUCT] += removed * sums[:, LIGHT]
    return whole.astype(np.float32)


def mean_illumination(
    photometry: Photometry,
    registration: Registration,
    model: ObservationModel,
    known: Photometry | None = None,
) -> Image:
    """Mean vignetting over the frames on the HR grid: what an image made without it has in it.

    Parameters
    ----------
    photometry : Photometry
    registration : Registration
    model : ObservationModel
    known : Photometry, optional
        What the image was made with, if not with an ideal sensor.
    """
    height, width = model.grid.shape
    had = Vignetting() if known is None else known.vignetting
    if photometry.vignetting == had:
        return np.ones((height, width), np.float32)
    illumination = photometry.illumination
    if known is not None:
        illumination = illumination / known.illumination
    y = np.linspace(0, height - 1, height // _COARSE + 2)
    x = np.linspace(0, width - 1, width // _COARSE + 2)
    points = model.grid.to_module(np.stack(np.meshgrid(x, y), axis=-1))
    total = np.zeros(points.shape[:2])
    used = np.flatnonzero(registration.used)
    for i in used:
        px = registration.camera.project(registration.homographies[i], points)
        px = np.nan_to_num(px, nan=-1.0).astype(np.float32)
        total += cv2.remap(
            illumination.astype(np.float32),
            px[..., 0],
            px[..., 1],
            cv2.INTER_LINEAR,
            borderMode=cv2.BORDER_REPLICATE,
        )
    at_y, at_x = np.mgrid[:height, :width].astype(np.float32)
    at_y *= np.float32((len(y) - 1) / max(height - 1, 1))
    at_x *= np.float32((len(x) - 1) / max(width - 1, 1))
    mean = (total / used.size).astype(np.float32)
    return np.asarray(cv2.remap(mean, at_x, at_y, cv2.INTER_LINEAR), np.float32)
