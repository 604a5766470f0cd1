"""Small valid inputs, for the readers to accept and for the mutations to start from."""

from __future__ import annotations

import io
import json
import sqlite3
import struct
import tempfile
from functools import cache
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import tifffile
from numpy.typing import NDArray

__all__ = [
    "jpegs",
    "pictures",
    "pngs",
    "result_files",
    "settings_text",
    "stored_review",
    "tiff_of",
    "tiffs",
]

Picture = NDArray[Any]
HEIGHT, WIDTH = 60, 80


def picture(seed: int = 0, top: float = 60000, dtype: Any = np.uint16) -> Picture:
    """Cells of uneven brightness between dark borders, with noise."""
    rng = np.random.default_rng(seed)
    y, x = np.mgrid[:HEIGHT, :WIDTH]
    cells = 0.5 + 0.3 * np.sin(x / 9.0 + seed) * np.cos(y / 7.0)
    cells[(x % 20 < 2) | (y % 20 < 2)] = 0.15
    return np.asarray((cells + 0.01 * rng.random(cells.shape)) * top).astype(dtype)


def _tiff(images: Picture | list[Picture], **how: Any) -> bytes:
    buffer = io.BytesIO()
    with tifffile.TiffWriter(
        buffer, **{k: how.pop(k) for k in ("bigtiff", "byteorder", "imagej", "ome") if k in how}
    ) as writer:
        for image in images if isinstance(images, list) else [images]:
            writer.write(image, **how)
    return buffer.getvalue()


def tiff_of(image: Picture) -> bytes:
    """Store a picture as it is."""
    return _tiff(image, photometric="minisblack", metadata=None)


def _truncated(images: Picture, **how: Any) -> bytes:
    buffer = io.BytesIO()
    tifffile.imwrite(buffer, images, truncate=True, photometric="minisblack", **how)
    return buffer.getvalue()


def _packed(image: Picture) -> bytes:
    """12 bits without gaps: the directory of 16 bits, with less behind it."""
    low, high = image[:, ::2].astype(int), image[:, 1::2].astype(int)
    packed = np.dstack([low >> 4, (low & 15) << 4 | high >> 8, high & 255]).astype(np.uint8)
    buffer = io.BytesIO(_tiff(image, photometric="minisblack", metadata=None))
    with tifffile.TiffFile(buffer, mode="r+b") as file:
        tags = file.pages[0].tags
        tags[258].overwrite(12)
        tags[279].overwrite(packed.nbytes)
        at = file.pages[0].dataoffsets[0]
    data = bytearray(buffer.getvalue())
    data[at : at + packed.nbytes] = packed.tobytes()
    return bytes(data)


def _by_opencv(suffix: str, image: Picture, *options: int) -> bytes:
    return bytes(cv2.imencode(suffix, image, list(options))[1])


@cache
def tiffs() -> tuple[bytes, ...]:
    """One of each kind that cameras and programs write, readable or not."""
    wide, narrow = picture(), picture(0, 250, np.uint8)
    grey = {"photometric": "minisblack", "metadata": None}
    pages = [picture(k) for k in range(3)]
    return (
        _tiff(wide, **grey),
        _tiff(narrow, **grey),
        _tiff(wide, byteorder=">", **grey),
        _tiff(wide, bigtiff=True, **grey),
        _tiff(wide, bigtiff=True, byteorder=">", compression="zlib", **grey),
        _tiff(wide, compression="zlib", predictor=True, **grey),
        _tiff(wide, rowsperstrip=7, **grey),
        _tiff(wide, tile=(32, 32), **grey),
        _tiff(wide, tile=(16, 48), compression="zlib", **grey),
        _tiff(wide, photometric="miniswhite", metadata=None),
        _tiff(pages, **grey),
        _tiff(pages, compression="zlib", **grey),
        _tiff(np.stack(pages), photometric="minisblack"),  # shaped
        _tiff(np.stack(pages), imagej=True),
        _tiff(np.stack(pages), ome=True, photometric="minisblack"),
        _tiff((wide / 65535).astype(np.float32), **grey),
        _tiff(wide.astype(np.int16), **grey),
        _tiff(narrow > 100, **grey),
        _tiff(np.dstack([narrow] * 3), photometric="rgb", metadata=None),
        _tiff(np.stack([narrow] * 3), photometric="rgb", planarconfig="separate", metadata=None),
        _tiff(narrow, photometric="palette", colormap=np.zeros((3, 256), np.uint16), metadata=None),
        _tiff(wide, subifds=0, description="frame 1", software="camera", **grey),
        _tiff(np.where(wide > 9000, wide / 1e4, np.nan).astype(np.float32), **grey),
        _tiff((wide / 65535).astype(np.float64), byteorder=">", **grey),
        _tiff(wide.astype(np.int32) - 20000, compression="zlib", **grey),
        _tiff(wide, extratags=[(274, "H", 1, 6, True)], **grey),
        _tiff([*pages, picture(3)[:40]], ome=True, photometric="minisblack"),
        _truncated(np.stack(pages), imagej=True),
        _truncated(np.stack(pages)),
        _packed(wide >> 4),
        _by_opencv(".tif", wide, cv2.IMWRITE_TIFF_COMPRESSION, 5),  # LZW
        _by_opencv(".tif", narrow, cv2.IMWRITE_TIFF_COMPRESSION, 5),
        _by_opencv(".tif", narrow, cv2.IMWRITE_TIFF_COMPRESSION, 7),  # JPEG
        _by_opencv(".tif", narrow, cv2.IMWRITE_TIFF_COMPRESSION, 32773),  # PackBits
    )


@cache
def pngs() -> tuple[bytes, ...]:
    """8 and 16 bits, grey, coloured, with alpha, with a palette or two colours."""
    wide, narrow = picture(), picture(0, 250, np.uint8)
    found = [
        _by_opencv(".png", wide),
        _by_opencv(".png", narrow),
        _by_opencv(".png", np.dstack([narrow] * 3)),
        _by_opencv(".png", np.dstack([wide] * 4)),
        _by_opencv(".png", (narrow > 100).astype(np.uint8) * 255, cv2.IMWRITE_PNG_BILEVEL, 1),
        _by_opencv(".png", wide, cv2.IMWRITE_PNG_COMPRESSION, 0),
        _by_opencv(".png", np.dstack([narrow, narrow - 2, narrow - 5])),
    ]
    return tuple(found)


def _with_exif(jpeg: bytes, orientation: int) -> bytes:
    exif = b"Exif\0\0II*\0\x08\0\0\0\1\0" + struct.pack("<HHIHHI", 274, 3, 1, orientation, 0, 0)
    return jpeg[:2] + b"\xff\xe1" + (len(exif) + 2).to_bytes(2) + exif + jpeg[2:]


@cache
def jpegs() -> tuple[bytes, ...]:
    """Other pictures of cells: JPEG grey, coloured and progressive, BMP."""
    narrow = picture(0, 250, np.uint8)
    return (
        _by_opencv(".jpg", narrow),
        _by_opencv(".jpg", np.dstack([narrow] * 3)),
        _by_opencv(".jpg", narrow, cv2.IMWRITE_JPEG_PROGRESSIVE, 1),
        _by_opencv(".jpg", narrow, cv2.IMWRITE_JPEG_RST_INTERVAL, 2),
        _with_exif(_by_opencv(".jpg", narrow), 6),
        _by_opencv(".bmp", narrow),
        _by_opencv(".bmp", np.dstack([narrow] * 3)),
    )


@cache
def pictures() -> tuple[bytes, ...]:
    """Every kind of picture."""
    return (*tiffs(), *pngs(), *jpegs())


@cache
def frames() -> dict[str, bytes]:
    """Three frames of one sequence, with their sidecar."""
    files = {
        f"frames/frame_{k}.tif": _tiff(picture(k), photometric="minisblack", metadata=None)
        for k in range(3)
    }
    return {**files, "frames/module.json": b'{"rows": 2, "cols": 3, "cell_aspect": 1.0}'}


@cache
def result_files() -> dict[str, bytes]:
    """A result folder, and the frames that it was made of, beside it."""
    from dataclasses import replace

    from pv_inspect.results.write import write_result
    from pv_inspect.sequence.sequence import FrameSequence
    from tests.handmade import FakeSequence, made_inspection

    with tempfile.TemporaryDirectory() as name:
        place = Path(name)
        for file, content in frames().items():
            (place / file).parent.mkdir(exist_ok=True)
            (place / file).write_bytes(content)
        opened = FrameSequence.open(place / "frames")
        made = FakeSequence(opened.names, opened.shape, opened.source, place / "frames")
        inspection = made_inspection(sequence=made)
        settings = replace(inspection).settings.changed(prior_weight=0.05, skip_frames=("a.tif",))
        write_result(replace(inspection, settings=settings), place / "result")
        return {
            str(path.relative_to(place)): path.read_bytes()
            for path in place.rglob("*")
            if path.is_file() and path.parent.name != "cells" and path.suffix != ".html"
        }


def flat_picture(level: float) -> bytes:
    """A picture that is even but for a little noise, as dark and flat frames are."""
    noise = np.random.default_rng(7).normal(0, 3, (HEIGHT, WIDTH))
    return _tiff((level + noise).astype(np.uint16), photometric="minisblack", metadata=None)


SESSION = json.dumps(
    {"cell": [1, 2], "frame": 1, "page": "image", "centre": [30.5, 40.0], "zoom": 3.5}
)


@cache
def kept_trials() -> bytes:
    """Content of a ``trials.npz``."""
    from pv_inspect.results.trials import KeptTrial, write_trials
    from pv_inspect.settings import Settings

    trials = [
        KeptTrial(
            number,
            Settings(prior_weight=0.1 * number, skip_frames=("a.png",), kappa=-0.25),
            picture(number, 1, np.float32),
            (1, 2),
            "4.00x",
            "lambda 1",
            "a name",
        )
        for number in (1, 2)
    ]
    with tempfile.TemporaryDirectory() as name:
        write_trials(trials, Path(name))
        return (Path(name) / "trials.npz").read_bytes()


@cache
def stored_review() -> bytes:
    """Content of a ``review.sqlite`` with verdicts, masks, notes and module data."""
    from pv_inspect.review import ReviewStore, Verdict, VerdictKind
    from pv_inspect.review.store import ReviewState
    from pv_inspect.review.verdicts import ModuleData

    with tempfile.TemporaryDirectory() as name:
        with ReviewStore(Path(name)) as store:
            store.give(Verdict(0, 1, VerdictKind.CRACK_A, "ann", note="at the busbar"))
            store.give(Verdict(0, 1, VerdictKind.OK, "bob"))
            store.note((1, 1), "ann", "look again")
            mask = np.zeros((40, 40), bool)
            mask[10:30, 20] = True
            store.correct((0, 1), "ann", mask, 0.5, None)
            edit = store.give(Verdict(1, 2, VerdictKind.CRACK_B, "ann", crack_length_cells=0.5))
            store.undo("ann", edit)
            store.describe(ModuleData(serial_number="7", current_a=8.5))
            store.remember(ReviewState("ann", 1, 2))
        return (Path(name) / "review.sqlite").read_bytes()


def changed_review(statements: list[str]) -> bytes:
    """Content of a ``review.sqlite`` after SQL that its own program would not run."""
    with tempfile.TemporaryDirectory() as name:
        path = Path(name) / "review.sqlite"
        path.write_bytes(stored_review())
        connection = sqlite3.connect(path, isolation_level=None)
        try:
            for statement in statements:
                try:
                    connection.execute(statement)
                except sqlite3.Error:  # statements may contradict each other
                    continue
        finally:
            connection.close()
        return path.read_bytes()


@cache
def settings_text() -> str:
    """Every setting once, as TOML."""
    from pv_inspect.settings import Settings

    return Settings(
        rows=2,
        cols=3,
        cell_aspect=1.0,
        module_at=(40, 30),
        kappa=-0.1,
        focal_length_px=900,
        prior_weight=0.1,
        psf_sigma_lr_px=0.4,
        crack_threshold=0.4,
        cell_width_mm=156,
        skip_frames=("a.tif", "b.tif"),
    ).to_toml()


@cache
def calibrations() -> tuple[tuple[str, str], ...]:
    """Name and text of calibration files in every form that is read."""
    from pv_inspect.calibration.camera_file import write_camera
    from pv_inspect.geometry.camera import Camera

    camera = Camera(np.array([[100.0, 0, 40], [0, 100, 30], [0, 0, 1]]), -0.1)
    with tempfile.TemporaryDirectory() as name:
        found = []
        for suffix in (".yaml", ".xml", ".json"):
            path = Path(name) / f"camera{suffix}"
            write_camera(path, camera, (HEIGHT, WIDTH))
            found.append((path.name, path.read_text()))
    ros = (
        "image_width: 80\nimage_height: 60\ncamera_matrix:\n  rows: 3\n  cols: 3\n"
        "  data: [100.0, 0.0, 40.0, 0.0, 100.0, 30.0, 0.0, 0.0, 1.0]\n"
        "distortion_coefficients:\n  rows: 1\n  cols: 5\n  data: [-0.1, 0.0, 0.0, 0.0, 0.0]\n"
    )
    result = '{"camera": {"K": [[100.0, 0, 40], [0, 100, 30], [0, 0, 1]], "kappa": -0.1}}'
    return (*found, ("ros.yaml", ros), ("result.json", result))


@cache
def model() -> tuple[bytes, str]:
    """The crack network of the package and its description."""
    from pv_inspect.cracks import network

    path = Path(network.__file__).with_name("models") / "default.onnx"
    return path.read_bytes(), path.with_suffix(".json").read_text()
