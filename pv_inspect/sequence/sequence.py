"""The sequence of frames: lazy, checked before anything runs, delivered in full-scale units."""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pv_inspect.errors import InspectionError, printable
from pv_inspect.geometry.layout import ModuleLayout
from pv_inspect.image_files.limits import ReadLimits
from pv_inspect.sequence.copies import FrameContents, copy_reasons
from pv_inspect.sequence.file_warnings import said_of_frames
from pv_inspect.sequence.frame import Frame, prepared
from pv_inspect.sequence.frame_files import FrameFile, read_frame
from pv_inspect.sequence.frame_list import list_frames
from pv_inspect.sequence.lock_in import LockIn, lock_in_of
from pv_inspect.sequence.modulation import LevelPictures
from pv_inspect.sequence.noise import NoiseModel, estimate_noise
from pv_inspect.sequence.opening import (
    DecodedFrames,
    check_frames,
    read_reference,
    sensor_of,
    with_compression,
)
from pv_inspect.sequence.sidecar import read_sidecar
from pv_inspect.sequence.told_layout import says_gaps, says_sizes, told_layout
from pv_inspect.sequence.values import Raw, ValueScale, comparable
from pv_inspect.settings import Settings

__all__ = ["FrameSequence", "NoiseModel", "cached_frames", "open_sequence"]

# Frames that the sensor's properties are estimated from; more add time, not knowledge.
_SAMPLE_FRAMES = 24
_SAMPLE_BYTES, _LEAST_SAMPLES = 256 * 2**20, 5
_CACHED_FRAMES, _LAST_FRAMES = 64, 8
_CACHED_BYTES = 128 * 2**20


def cached_frames(n_frames: int, shape: tuple[int, int]) -> int:
    """Return how many of the frames, (height, width), are kept ready for use, 5 bytes a pixel.

    All of them, or the last few: of a pass over more frames than are kept, none is there any more
    when the next pass comes to it.
    """
    fitting = int(np.clip(_CACHED_BYTES // (5 * shape[0] * shape[1]), 2, _CACHED_FRAMES))
    return n_frames if n_frames <= fitting else min(fitting, _LAST_FRAMES)


class _FrameCache:
    """The frames used last, for several threads; travels empty through pickle."""

    def __init__(self, capacity: int) -> None:
        self._capacity = capacity
        self._frames: OrderedDict[int, Frame] = OrderedDict()
        self._lock = threading.Lock()

    def get(self, index: int) -> Frame | None:
        with self._lock:
            if index in self._frames:
                self._frames.move_to_end(index)
            return self._frames.get(index)

    def put(self, index: int, frame: Frame) -> None:
        with self._lock:
            self._frames[index] = frame
            while len(self._frames) > self._capacity:
                self._frames.popitem(last=False)

    def __reduce__(self) -> tuple[type[_FrameCache], tuple[int]]:
        return _FrameCache, (self._capacity,)


@dataclass(frozen=True, eq=False)
class FrameSequence:
    """Frames of one module taken by one camera; lazy and immutable.

    Open one with `open_sequence`. It holds the sensor's properties and file names; pixels are read
    when asked for (the frames used last stay in a small cache). Reading from several threads is
    safe, and it pickles.

    Parameters
    ----------
    names : tuple of str
        File name per frame: ``frame_003.tif``, or ``stack.tif[3]`` for a page.
    shape : tuple of int
        (height, width) of every frame.
    bit_depth : int or None
        Bits that the camera delivers, for instance 12 though stored in 16; None where the files
        hold computed values (averaged, corrected), see `pv_inspect.sequence.values`.
    full_scale : float
        Stored value at saturation; for computed values what is taken for it.
    black_level : float
        Stored value without light: estimated, or the median of the dark frame. :meth:`frame`
        subtracts it together with the fixed offsets of the columns (or the dark frame pixel by
        pixel).
    layout_hint : dict
        What ``module.json`` says of rows, cols, cell_aspect and gaps; empty if there is none.
    source : Path
        What was opened; the folder of the first one for a list of files.
    noise : NoiseModel
        Variance over intensity, full-scale units.
    defects : (height, width) bool
        Hot and dead pixels of the sensor.
    opened_from : Path or tuple of Path
        What :meth:`open` was given, absolute: it opens the same frames again.
    copies : mapping of int to int
        Frames that repeat another one, bit for bit or with its noise, and that frame. They are no
        measurements of their own: nothing is estimated from them.
    warnings : tuple of str
        What is worth knowing about the files.
    lock_in : LockIn or None
        By daylight: :meth:`frame` then returns differences of frames with and without current.
    """

    names: tuple[str, ...]
    shape: tuple[int, int]
    bit_depth: int | None
    full_scale: float
    black_level: float
    layout_hint: dict[str, Any]
    source: Path
    noise: NoiseModel
    defects: NDArray[np.bool_] = field(repr=False)
    _files: tuple[FrameFile, ...] = field(repr=False)
    # (width,) or, out of a dark frame, (height, width); DN.
    _black: NDArray[np.float32] = field(repr=False)
    _cache: _FrameCache = field(repr=False)
    _scale: ValueScale = field(repr=False)
    # (height, width) relative response out of a flat frame, 0 where there is none.
    _flat: NDArray[np.float32] | None = field(default=None, repr=False)
    opened_from: Path | tuple[Path, ...] = ()
    copies: Mapping[int, int] = field(default_factory=dict)
    warnings: tuple[str, ...] = ()
    lock_in: LockIn | None = None

    @classmethod
    def open(
        cls,
        source: Path | str | Iterable[Path | str],
        dark_frame: Path | str | None = None,
        flat_frame: Path | str | None = None,
        limits: ReadLimits | None = None,
        series: str | None = None,
        lock_in: bool | None = None,
    ) -> FrameSequence:
        """Open frames and check all of them.

        Parameters
        ----------
        source : path or paths
            A folder of images (or one that holds such a folder called ``frames``), a file that
            holds several, or a list of files. A folder is read in natural order (frame_2 before
            frame_10), a list in its own.
        dark_frame : path, optional
            Image taken without current with the same camera and exposure.
        flat_frame : path, optional
            Image of an evenly bright surface taken with the same camera and lens.
        limits : ReadLimits, optional
            What is read at most, `Settings.read_limits`; the default limits if not given.
        series : str, optional
            Name, or number from 1, of the pictures that are meant where a file holds several
            series of them.
        lock_in : bool, optional
            Whether the frames are taken by daylight with the current switched on and off, and
            differences of them are wanted; found in the frames if not given.

        Raises
        ------
        InspectionError
            If anything is missing, unreadable, of different sizes or of the wrong type.
        """
        limits = limits or ReadLimits()
        if not isinstance(source, (str, Path)):
            source = list(source)
        found = list_frames(source, limits, series)
        root, files, names = found.root, found.files, found.names
        hint = read_sidecar(root, list(found.paths))
        contents, pictures = FrameContents(), LevelPictures()
        decoded = DecodedFrames(files, _SAMPLE_BYTES)
        shape, survey = check_frames(files, names, contents, decoded, pictures)
        copies = contents.copies(lambda index: comparable(decoded[index]))
        dtype = files[0].dtype
        dark_raw = flat_raw = None
        if dark_frame is not None:
            dark_raw = read_reference(Path(dark_frame), "dark", shape, files[0], limits)
            survey.reach(dark_raw)
        if flat_frame is not None:
            flat_raw = read_reference(Path(flat_frame), "flat", shape, files[0], limits)
            if flat_raw.dtype.kind == "f":
                survey.reach(flat_raw)
        scale = survey.scale([file.picture for file in files])
        full_scale = scale.full_scale_dn

        distinct = [index for index in range(len(files)) if index not in copies]
        size = max(dtype.itemsize, 4 * (dtype.kind == "f"))
        most = max(_LEAST_SAMPLES, _SAMPLE_BYTES // (size * shape[0] * shape[1]))
        n_picks = min(len(distinct), _SAMPLE_FRAMES, most)
        picks = np.unique(np.linspace(0, len(distinct) - 1, n_picks).round())
        raws = [decoded[distinct[int(i)]] for i in picks]
        stack = np.stack([scale.dn(raw)[0] for raw in raws])
        sensor = sensor_of(
            stack,
            scale,
            None if dark_frame is None or dark_raw is None else (Path(dark_frame), dark_raw),
            None if flat_frame is None or flat_raw is None else (Path(flat_frame), flat_raw),
        )
        frames = [sensor.prepared(raw, scale) for raw in raws[:: max(1, len(raws) // 8)]]
        noise = estimate_noise([f.image for f in frames], [f.valid for f in frames])
        noise = with_compression(noise, files, full_scale)
        found_lock_in = lock_in_of(
            pictures,
            distinct,
            lambda index: sensor.prepared(decoded[index], scale),
            names,
            lock_in,
        )
        if found_lock_in is not None:
            # What only the frames with current show would be in every difference.
            glowing = [scale.dn(decoded[k])[0] for k in list(found_lock_in.pairs)[:most]]
            sensor = sensor.with_defects_in(np.stack(glowing), full_scale)
        return cls(
            names,
            shape,
            scale.bit_depth,
            scale.full_scale,
            sensor.level / scale.factor,
            hint,
            root,
            noise,
            sensor.defects,
            files,
            sensor.black,
            _FrameCache(cached_frames(len(names), shape)),
            scale,
            sensor.flat,
            root.absolute()
            if isinstance(source, (str, Path))
            else tuple(path.absolute() for path in found.paths),
            copies,
            (*found.warnings, *said_of_frames(files, survey, scale, len(decoded.tinted))),
            found_lock_in,
        )

    def __len__(self) -> int:
        return len(self.names)

    def raw(self, index: int) -> Raw:
        """Read frame ``index`` as stored: (height, width) uint8, uint16 or float32."""
        return read_frame(self._files[index])

    def frame(self, index: int) -> Frame:
        """Return frame ``index`` ready for use.

        Raises
        ------
        InspectionError
            If the file has become unreadable since the sequence was opened.
        """
        if not -len(self) <= index < len(self):
            raise IndexError(f"Frame {index} of a sequence of {len(self)}.")
        index %= len(self)
        frame = self._cache.get(index)
        if frame is None:
            if self.lock_in is None:
                frame = self._exposed(index)
            else:
                frame = self.lock_in.difference(index, self._exposed, self.noise)
            self._cache.put(index, frame)
        return frame

    def _exposed(self, index: int) -> Frame:
        level = self.black_level * self._scale.factor
        return prepared(self.raw(index), self._black, level, self._scale, self.defects, self._flat)

    @cached_property
    def no_measurements(self) -> dict[int, str]:
        """Frames that nothing is measured in whatever they show, with the reason.

        Copies of others; by daylight the frames without current, and those without a partner.
        """
        reasons = copy_reasons(self.copies, self.names)
        return reasons if self.lock_in is None else self.lock_in.dark_and_unused | reasons

    @property
    def removed_columns(self) -> NDArray[np.float32] | None:
        """What :meth:`frame` takes out of every column besides the black level, full scale = 1.

        (width,); None where a dark or flat frame says more, or differences of frames are used.
        """
        if self._flat is not None or self._black.ndim > 1 or self.lock_in is not None:
            return None
        level = np.float32(self.black_level * self._scale.factor)
        return (self._black - level) / (np.float32(self._scale.full_scale_dn) - level)

    @property
    def without_current(self) -> frozenset[int]:
        """By daylight, the frames that were subtracted from others."""
        return frozenset() if self.lock_in is None else frozenset(self.lock_in.dark)

    @property
    def measured(self) -> list[int]:
        """The frames that measure something."""
        return [index for index in range(len(self)) if index not in self.no_measurements]

    def indices(self, names: Iterable[str]) -> list[int]:
        """Return the indices of frames given by name.

        Raises
        ------
        InspectionError
            If there is no such frame.
        """
        where = {name: index for index, name in enumerate(self.names)}
        wanted = [printable(name) for name in names]
        unknown = [name for name in wanted if name not in where]
        if unknown:
            raise InspectionError(
                f"There is no frame '{unknown[0]}' in {self.source}: its frames are called "
                f"{self.names[0]} to {self.names[-1]}."
            )
        return [where[name] for name in wanted]

    def layout(self, settings: Settings) -> ModuleLayout:
        """Return the module's layout; settings win over ``module.json``.

        Raises
        ------
        InspectionError
            If neither says how many rows and columns of cells the module has.
        """
        return told_layout(self.layout_hint, settings, self.source)

    def says_gaps(self, settings: Settings) -> bool:
        """Whether the settings or ``module.json`` say which gaps are wide, or that none is."""
        return says_gaps(self.layout_hint, settings)

    def says_sizes(self, settings: Settings) -> bool:
        """Whether the settings or ``module.json`` name rows or columns of other cells."""
        return says_sizes(self.layout_hint, settings)


def open_sequence(
    source: Path | str | Iterable[Path | str],
    dark_frame: Path | str | None = None,
    flat_frame: Path | str | None = None,
    limits: ReadLimits | None = None,
    series: str | None = None,
    lock_in: bool | None = None,
) -> FrameSequence:
    """Open frames and check all of them; `FrameSequence.open` says more.

    Parameters
    ----------
    source : path or paths
        A folder of frames, a file that holds several, or a list of files.
    dark_frame, flat_frame : path, optional
        Reference images of the camera.
    limits : ReadLimits, optional
        What is read at most.
    series : str, optional
        Which pictures are meant where a file holds several series of them: name, or number from 1.
    lock_in : bool, optional
        Whether the frames show the module by daylight, with and without current; found in them if
        not given.

    Returns
    -------
    FrameSequence

    Raises
    ------
    InspectionError
        If anything is missing, unreadable, of different sizes or of the wrong type.
    """
    return FrameSequence.open(source, dark_frame, flat_frame, limits, series, lock_in)
