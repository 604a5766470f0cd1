"""Cracks in plain images of single cells, without a sequence or a module around them."""

from __future__ import annotations

import io
import os
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import tifffile
from numpy.typing import NDArray

from pv_inspect.common.csv_tables import csv_text
from pv_inspect.cracks import BusbarFinder, CrackDetector, novelty_of, operating_point_of
from pv_inspect.cracks.blocks import cut_off_blocks
from pv_inspect.cracks.completion import completed
from pv_inspect.cracks.features import FEATURES, CellFeatures, measure_cell, texts
from pv_inspect.cracks.isolation import busbars_from_image, busbars_from_map
from pv_inspect.cracks.module_pictures import module_in
from pv_inspect.errors import InspectionError, printable
from pv_inspect.image_files.jpeg import read_photo
from pv_inspect.image_files.limits import ReadLimits
from pv_inspect.image_files.problems import ImageFileError
from pv_inspect.sequence.frame_files import expand, natural_key, read_floats, read_frame
from pv_inspect.settings import Settings

__all__ = ["PlainCell", "cells_csv", "image_files", "read_cell", "read_plain_cell", "tiff_bytes"]

Image = NDArray[np.float32]

SUFFIXES = (".png", ".tif", ".tiff", ".jpg", ".jpeg", ".bmp")
_SMALLEST_PX, _LARGEST_ASPECT = 24, 6
# Median of an ordinary cell divided by its 95th percentile.
_USUAL_OF_BRIGHT = 0.85
# JPEG may tint grey a little.
_TINT = 8


@dataclass(frozen=True, eq=False)
class PlainCell:
    """What was found in one image.

    Parameters
    ----------
    stem : str
        File name without its ending.
    probability : (h, w) float32
        At the size of the image.
    features : CellFeatures
        Row and column are 0.
    """

    stem: str
    probability: Image
    features: CellFeatures


def image_files(given: Iterable[Path]) -> list[Path]:
    """List images: files as given, folders with all images in them.

    Raises
    ------
    InspectionError
        If a path does not exist, there are no images, or two share a stem.
    """
    files: list[Path] = []
    for path in given:
        try:
            if path.is_dir():
                files += sorted(
                    filter(_is_image, path.iterdir()), key=lambda p: natural_key(p.name)
                )
            elif os.path.lexists(path):
                files.append(path)
            else:
                raise InspectionError(f"{path} does not exist: give images of cells or a folder.")
        except OSError as error:
            raise InspectionError(
                f"{path} can't be read ({error.strerror}): check its name and its permissions."
            ) from None
    if not files:
        raise InspectionError(
            f"There are no images in {', '.join(str(p) for p in given)}: give images of cells "
            f"({', '.join(SUFFIXES)}) or a folder of them."
        )
    stems: dict[str, Path] = {}
    for path in files:
        other = stems.setdefault(path.stem, path)
        if other is not path:
            raise InspectionError(
                f"{other} and {path} would both be written to {path.stem}.tif: rename one or "
                "give them one after the other."
            )
    return files


def _is_image(path: Path) -> bool:
    """Whether the name says so; what is no file after all is told when it is read."""
    hidden = path.name.startswith(".")
    return path.suffix.lower() in SUFFIXES and not hidden and not path.is_dir()


def read_cell(path: Path, limits: ReadLimits | None = None) -> Image:
    """Read the image of one cell.

    Parameters
    ----------
    path : Path
        8 or 16 bit, or floating point (TIFF only).
    limits : ReadLimits, optional
        What is read at most, `Settings.read_limits`; the default limits if not given.

    Returns
    -------
    (h, w) float32
        Full scale = 1; floating point as it is.

    Raises
    ------
    InspectionError
        If it can't be read or is no cell: coloured, too small, constant, or with NaN.
    """
    pixels = _pixels(path, limits or ReadLimits())
    name = path.name
    h, w = pixels.shape
    if min(h, w) < _SMALLEST_PX or max(h, w) > _LARGEST_ASPECT * min(h, w):
        raise InspectionError(
            f"{name} is {w} x {h} px, but a cell needs at least {_SMALLEST_PX} px on its shorter "
            f"side and at most {_LARGEST_ASPECT} times that on the longer: cut out whole cells."
        )
    full_scale = {1: 255, 2: 65535}[pixels.dtype.itemsize] if pixels.dtype.kind == "u" else 1
    image = np.asarray(pixels, np.float32) / np.float32(full_scale)
    if not np.isfinite(image).all():
        n = int((~np.isfinite(image)).sum())
        raise InspectionError(
            f"{name} has {n} pixels that are no numbers, but a cell needs a value everywhere: "
            "fill them or cut them away."
        )
    if float(np.ptp(image)) <= 0:
        raise InspectionError(
            f"{name} has the same value {float(image.flat[0]):g} everywhere, so that it shows no "
            "cell: remove it or export it again."
        )
    return image


def _pixels(path: Path, limits: ReadLimits) -> NDArray[np.generic]:
    if path.suffix.lower() in (".png", ".tif", ".tiff"):
        pages = expand(path, limits)
        if len(pages) > 1:
            raise InspectionError(
                f"{path.name} has {len(pages)} pages, but an image of a cell has one: save every "
                "cell as its own file."
            )
        dtype = pages[0].dtype
        if dtype.kind != "f" and dtype not in (np.uint8, np.uint16):
            raise InspectionError(
                f"{path.name} holds {dtype} values, but images of cells are 8- or 16-bit unsigned "
                "or floating-point: export it so, without scaling."
            )
        return read_floats(pages[0]) if dtype.kind == "f" else read_frame(pages[0])
    try:
        image = read_photo(path, limits)
    except ImageFileError as problem:
        raise InspectionError(f"{path.name} {problem}") from None
    if image.ndim == 3:
        colours = np.asarray(image[..., :3], np.int16)
        if np.ptp(colours, axis=2).max() > _TINT:
            raise InspectionError(
                f"{path.name} is a colour image, but a cell has one grey channel: export it as "
                "grey, without a colour map."
            )
        image = image[..., 1]
    return np.asarray(image)


def read_plain_cell(path: Path, detector: CrackDetector, settings: Settings) -> PlainCell:
    """Look for cracks in one image.

    Parameters
    ----------
    path : Path
    detector : CrackDetector
    settings : Settings
        ``crack_threshold``, ``cell_width_mm`` and ``max_frame_mpx`` are used.

    Raises
    ------
    InspectionError
        See `read_cell`; also if it looks like a whole module.
    """
    image = read_cell(path, settings.read_limits)
    if (module := module_in(image)) is not None:
        raise InspectionError(
            f"{path.name} shows a grid of about {module.rows} x {module.cols} cells and looks like "
            "a whole module, not like one cell: give it to `pv-inspect run`, or cut the cells out."
        )
    point = operating_point_of(detector, settings)
    if isinstance(detector, BusbarFinder):
        probability, bars = detector.read(image)
        busbars = busbars_from_map(bars)
    else:
        probability, busbars = detector.probability(image), busbars_from_image(image)
    width, blocks = float(image.shape[1]), cut_off_blocks(image)
    probability = completed(probability, image, blocks, point, width)
    features = measure_cell(
        image,
        probability,
        point.threshold,
        row=0,
        col=0,
        cell_width_px=width,
        usual_intensity=_USUAL_OF_BRIGHT * float(np.percentile(image, 95)),
        busbars=busbars,
        cell_width_mm=settings.cell_width_mm,
        least_extent_cells=point.least_extent_cells,
        least_length_cells=point.least_length_cells,
        least_score=point.least_score,
        novelty=novelty_of(detector, image),
        blocks=blocks,
    )
    return PlainCell(path.stem, probability, features)


def tiff_bytes(probability: Image) -> bytes:
    """Probability map as a float32 TIFF."""
    buffer = io.BytesIO()
    tifffile.imwrite(
        buffer, probability, photometric="minisblack", compression="zlib", metadata=None
    )
    return buffer.getvalue()


def cells_csv(cells: Iterable[PlainCell]) -> str:
    """Return a table of the features, one line per image."""

    def lines() -> Iterator[list[object]]:
        yield ["file", *FEATURES, "crack_class"]
        for cell in cells:
            yield [f"{printable(cell.stem)}.tif", *texts(cell.features), cell.features.crack_class]

    return csv_text(lines())
