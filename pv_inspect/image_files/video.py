"""Video: the frames of AVI, MP4, Matroska and MJPEG files, decoded by PyAV.

Brightness is taken from the plane that holds it, with all of its bits; where the colours say
something, the whole picture is converted. Containers are told by their first bytes and no other
demuxer is tried, since some follow the names of other files.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from functools import lru_cache
from itertools import islice
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from pv_inspect.image_files.forward import ForwardReader
from pv_inspect.image_files.jpeg_loss import error_variance_of
from pv_inspect.image_files.limits import ReadLimits, check_size
from pv_inspect.image_files.orientation import AS_STORED, turned, turned_shape
from pv_inspect.image_files.picture import Listing, Picture
from pv_inspect.image_files.problems import ImageFileError, damaged, needs_package
from pv_inspect.image_files.raw_avi import RawAvi, raw_avi, raw_avi_pixels, raw_picture
from pv_inspect.image_files.regular import FileState, open_regular
from pv_inspect.image_files.series import Series, chosen_series, left_out

__all__ = ["decoded_video", "listed_video", "video_error_variance"]

Pixels = NDArray[Any]

# Turned counterclockwise by so many degrees to be shown, as FFmpeg says it: the value of the tag.
_TURNED = {0: AS_STORED, 90: 8, -90: 6, 180: 3, -180: 3, 270: 6, -270: 8}
# Colours whose two channels stay within so many levels of 8 bits are rounding.
_NEUTRAL = 2
_FULL_RANGE = 2
# FFmpeg's AV_CODEC_PROP_LOSSY.
_LOSSY = 2
_forward = ForwardReader()


def listed_video(path: Path, state: FileState, limits: ReadLimits, series: str | None) -> Listing:
    """List the pictures of a video; see `ImageFormat`."""
    raw = _raw(path, state, limits)
    if raw is not None:
        return Listing(tuple(raw_picture(raw, k) for k in range(len(raw.frames))))
    with open_regular(path, state) as file:
        with _opened(file, limits) as container:
            first = [_first(container, stream, limits) for stream in container.streams.video]
        if not first:
            raise damaged("there is no picture in it")
        counts = [_count(file, index, limits) for index in range(len(first))]
    found = [
        Series("", n, picture.shape, picture.dtype, False)
        for picture, n in zip(first, counts, strict=True)
    ]
    chosen = chosen_series(found, series)
    picture = first[chosen]
    pictures = tuple(
        Picture(
            picture.shape,
            picture.dtype,
            (chosen, k),
            picture.bits,
            picture.coloured,
            picture.lossy,
            picture.orientation,
        )
        for k in range(counts[chosen])
    )
    return Listing(pictures, left_out(found, chosen))


def decoded_video(path: Path, state: FileState, picture: Picture, limits: ReadLimits) -> Pixels:
    """Decode a picture of a video; see `ImageFormat`."""
    stream, index = map(int, picture.place)
    raw = _raw(path, state, limits)
    if raw is not None:
        with open_regular(path, state) as file:
            return raw_avi_pixels(file, raw, index)

    def begin() -> Iterator[Pixels]:
        with open_regular(path, state) as file, _opened(file, limits) as container:
            for frame in container.decode(container.streams.video[stream]):
                if frame.is_corrupt:
                    raise damaged("a frame of the video is damaged")
                image = _pixels(frame)
                if image.shape[:2] != turned_shape(*picture.shape, picture.orientation):
                    raise damaged("its frames change their size")
                if image.dtype != picture.dtype:
                    raise damaged("its frames change their type")
                yield turned(image, picture.orientation)

    return _forward.picture((path, state, stream), index, begin)


def video_error_variance(
    path: Path, state: FileState, picture: Picture, limits: ReadLimits, most: int
) -> float:
    """Estimate the mean squared error of a video of JPEG pictures from its first ones.

    Returns
    -------
    float
        DN^2 of 8 bits; 0 for other videos.
    """
    try:
        with open_regular(path, state) as file, _opened(file, limits) as container:
            stream = container.streams.video[int(picture.place[0])]
            if stream.codec_context.name != "mjpeg":
                return 0.0
            packets = [bytes(packet) for packet in islice(container.demux(stream), most)]
    except ImageFileError:
        return 0.0
    return float(np.median([error_variance_of(packet, limits) for packet in packets] or [0.0]))


@lru_cache(maxsize=4)
def _raw(path: Path, state: FileState, limits: ReadLimits) -> RawAvi | None:
    with open_regular(path, state) as file:
        return raw_avi(file, limits)


@contextmanager
def _opened(file: BinaryIO, limits: ReadLimits) -> Iterator[Any]:
    demuxer = _demuxer(file)
    try:
        import av
    except ImportError:
        raise needs_package("a video", "video") from None
    file.seek(0)
    try:
        with av.open(file, "r", format=demuxer) as container:
            for stream in container.streams.video:
                context = stream.codec_context
                if context is None:
                    raise ImageFileError(
                        "is a video of an unknown kind, for which there is no decoder: save it as "
                        "TIFF, or as AVI without compression."
                    )
                if context.width and context.height:
                    check_size(context.height, context.width, 2, limits)
                context.thread_count = 1
                context.options = {"err_detect": "explode"}
            yield container
    except (av.FFmpegError, UnicodeError, OverflowError, MemoryError) as error:
        text = str(getattr(error, "strerror", None) or error) or type(error).__name__
        raise damaged(f"the video is damaged, {text[:80]}") from None


def _demuxer(file: BinaryIO) -> str:
    file.seek(0)
    head = file.read(12)
    if head[:4] == b"RIFF" and head[8:] == b"AVI ":
        return "avi"
    if head[4:8] in (b"ftyp", b"moov", b"mdat", b"wide", b"free", b"skip"):
        return "mov"
    if head[:4] == b"\x1a\x45\xdf\xa3":
        return "matroska"
    if head[:3] == b"\xff\xd8\xff":
        return "mjpeg"
    raise damaged("it is no AVI, MP4, Matroska or MJPEG video")


def _first(container: Any, stream: Any, limits: ReadLimits) -> Picture:
    """What the first frame of a stream is."""
    container.seek(0)
    frame = next(container.decode(stream), None)
    if frame is None:
        raise damaged("there is no picture in it")
    check_size(frame.height, frame.width, 2, limits)
    image = _pixels(frame)
    orientation = _TURNED.get(round(frame.rotation), AS_STORED)
    bits = _bits(frame)
    return Picture(
        turned_shape(image.shape[0], image.shape[1], orientation),
        image.dtype,
        (),
        bits if 8 < bits < 16 else 0,
        image.ndim == 3,
        bool(int(stream.codec_context.codec.properties) & _LOSSY),
        orientation,
    )


def _count(file: BinaryIO, index: int, limits: ReadLimits) -> int:
    """Number of pictures of a stream, from its packets."""
    with _opened(file, limits) as container:
        stream = container.streams.video[index]
        n = n_empty = 0
        for packet in container.demux(stream):
            n += packet.size > 0
            n_empty += packet.size == 0
            if n > limits.max_frames:
                raise ImageFileError(
                    f"has more than {limits.max_frames} pictures, but a sequence has about 20: "
                    "take some of them, or raise max_frames."
                )
        # The last packet is an empty one that ends the stream.
        if stream.frames > n + max(n_empty - 1, 0):
            raise damaged(f"the file ends too early, after {n} of {stream.frames} pictures")
    return n


def _bits(frame: Any) -> int:
    return max(int(component.bits) for component in frame.format.components)


def _pixels(frame: Any) -> Pixels:
    """(height, width) or (height, width, 3) of a frame, uint8 or uint16 with the bits it has."""
    kind, bits = frame.format, _bits(frame)
    planar = kind.is_planar or len(kind.components) == 1
    if planar and not kind.is_rgb and not kind.has_palette and kind.components[0].is_luma:
        neutral = 2 ** (bits - 1)
        slack = _NEUTRAL * 2 ** max(bits - 8, 0)
        # Grey has one component, the others two of colour and, perhaps, one of transparency.
        chroma = [_plane(frame, k) for k in (1, 2)] if len(kind.components) >= 3 else []
        if all(np.abs(plane.astype(np.int32) - neutral).max() <= slack for plane in chroma):
            luma = _plane(frame, 0)
            narrow = bool(chroma) and frame.color_range != _FULL_RANGE and "yuvj" not in kind.name
            return _widened(luma, bits) if narrow else luma
    if bits <= 8:
        return np.asarray(frame.to_ndarray(format="rgb24"))
    wide = np.asarray(frame.to_ndarray(format="rgb48le")).astype(np.uint16)
    return wide >> np.uint16(16 - bits)


def _plane(frame: Any, k: int) -> Pixels:
    """Values of one plane."""
    plane = frame.planes[k]
    big = frame.format.is_big_endian
    dtype = np.dtype(np.uint8 if _bits(frame) <= 8 else (">u2" if big else "<u2"))
    rows = np.frombuffer(plane, np.uint8).reshape(-1, abs(plane.line_size))[: plane.height]
    if plane.line_size < 0:
        rows = rows[::-1]
    values = np.ascontiguousarray(rows[:, : plane.width * dtype.itemsize]).view(dtype)
    return values.astype(dtype.newbyteorder("="))


def _widened(luma: Pixels, bits: int) -> Pixels:
    """Bring brightness that is stored from 16 to 235 (of 8 bits) to the whole range."""
    most, unit = 2**bits - 1, 2 ** (bits - 8)
    table = np.rint((np.arange(2**bits) - 16.0 * unit) * most / (219.0 * unit))
    widened: Pixels = np.clip(table, 0, most).astype(luma.dtype)[np.minimum(luma, most)]
    return widened
