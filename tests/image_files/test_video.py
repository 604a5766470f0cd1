from __future__ import annotations

import struct
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from pv_inspect.errors import InspectionError
from pv_inspect.image_files.limits import ReadLimits
from pv_inspect.sequence.frame_files import expand, read_frame
from pv_inspect.sequence.sequence import FrameSequence
from tests.image_files.making import scene

Stack = NDArray[Any]
SHAPE = (60, 82)


def stack(n: int = 6, bits: int = 8) -> Stack:
    frames = np.stack([scene("uint16", SHAPE) // (1 + 0.05 * k) for k in range(n)])
    return (frames / 65536 * 2**bits).astype(np.uint8 if bits == 8 else np.uint16)


def write(
    path: Path,
    codec: str,
    kind: str,
    frames: Stack,
    change: Callable[[Any], None] | None = None,
    demuxer: str | None = None,
) -> Path:
    av = pytest.importorskip("av")
    with av.open(str(path), "w", format=demuxer) as container:
        stream = container.add_stream(codec, rate=10)
        stream.height, stream.width = frames.shape[1:3]
        stream.pix_fmt = kind
        if change is not None:
            change(stream)
        for k, image in enumerate(frames):
            source = {3: "rgb24"}.get(image.ndim, "gray" if image.dtype == np.uint8 else "gray16le")
            if kind == "gray10le":
                frame = av.VideoFrame(image.shape[1], image.shape[0], kind)
                plane = np.zeros((image.shape[0], frame.planes[0].line_size // 2), "<u2")
                plane[:, : image.shape[1]] = image
                frame.planes[0].update(plane.tobytes())
            else:
                frame = av.VideoFrame.from_ndarray(image, format=source).reformat(format=kind)
            frame.pts = k
            container.mux(stream.encode(frame))
        container.mux(stream.encode(None))
    return path


def read(path: Path, series: str | None = None) -> Stack:
    return np.stack([read_frame(file) for file in expand(path, series=series)])


def complaint(path: Path) -> str:
    with pytest.raises(InspectionError) as caught:
        read(path)
    said = str(caught.value)
    assert len(said) < 400
    assert said.startswith(path.name)
    return said


# -- the same pixels ----------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "codec", "kind", "bits"),
    [
        ("x.avi", "ffv1", "gray", 8),
        ("x.avi", "huffyuv", "rgb24", 8),
        ("x.mkv", "ffv1", "gray16le", 16),
        ("x.mkv", "ffv1", "gray10le", 10),
        ("x.mov", "png", "gray", 8),
        ("x.mov", "png", "gray16be", 16),
    ],
)
def test_lossless_video_keeps_every_value(
    tmp_path: Path, name: str, codec: str, kind: str, bits: int
) -> None:
    frames = stack(bits=bits)
    path = write(tmp_path / name, codec, kind, frames)
    files = expand(path)
    assert [file.label(name) for file in files] == [f"{name}[{k}]" for k in range(6)]
    assert not any(file.picture.lossy for file in files)
    assert files[0].picture.bits == (10 if bits == 10 else 0)
    np.testing.assert_array_equal(read(path), frames)
    for k in (4, 1, 0, 5, 5):  # in any order
        np.testing.assert_array_equal(read_frame(files[k]), frames[k])


@pytest.mark.parametrize(
    ("name", "codec", "kind"),
    [
        ("x.avi", "mjpeg", "yuvj420p"),
        ("x.mjpeg", "mjpeg", "yuvj420p"),
        ("x.mp4", "mpeg4", "yuv420p"),
        ("x.mp4", "libx264", "yuv420p"),
        ("x.mkv", "libx264", "yuv420p"),
    ],
)
def test_compressed_video_is_read_over_its_whole_range(
    tmp_path: Path, name: str, codec: str, kind: str
) -> None:
    frames = np.clip(cv2.GaussianBlur(stack()[0], (0, 0), 2), 0, 255)
    frames = np.stack([frames, 255 - frames, frames, frames])
    frames[:, :20, :20], frames[:, -20:, :20] = 0, 255

    def well(stream: Any) -> None:
        stream.bit_rate = 4_000_000

    path = write(tmp_path / name, codec, kind, frames, well)
    files = expand(path)
    assert len(files) == 4
    assert all(file.picture.lossy for file in files)
    away = read(path).astype(int) - frames
    assert np.abs(away).mean() < 3
    # Black is 0 and white is 255, not 16 and 235.
    assert read(path)[:, 5:15, 5:15].max() <= 3
    assert read(path)[:, -15:-5, 5:15].min() >= 252


def test_a_video_is_a_sequence_with_a_warning(tmp_path: Path) -> None:
    def well(stream: Any) -> None:
        stream.bit_rate = 4_000_000

    path = write(tmp_path / "x.avi", "mjpeg", "yuvj420p", stack(), well)
    for source in (path, tmp_path):
        sequence = FrameSequence.open(source)
        assert len(sequence) == 6
        assert any("video, compressed with loss" in text for text in sequence.warnings)


def test_what_jpeg_has_taken_from_a_video_is_noise(tmp_path: Path) -> None:
    noises = []
    for step in ("20", "3"):

        def coarse(stream: Any, step: str = step) -> None:
            stream.options = {"qmin": step, "qmax": step}

        path = write(tmp_path / f"{step}.avi", "mjpeg", "yuvj420p", stack(), coarse)
        noises.append(FrameSequence.open(path).noise)
    lossless = FrameSequence.open(write(tmp_path / "x.avi", "ffv1", "gray", stack())).noise
    assert [noise.grain_px for noise in (*noises, lossless)] == [8, 8, 1]
    assert noises[0].read_variance > 2 * noises[1].read_variance > 0


def test_what_opencv_writes_is_read(tmp_path: Path) -> None:
    for name, code, slack in (("a.avi", cv2.VideoWriter.fourcc(*"MJPG"), 6), ("b.avi", 0, 1)):
        writer = cv2.VideoWriter(str(tmp_path / name), code, 10, SHAPE[::-1])
        for image in stack():
            writer.write(np.dstack([image] * 3))
        writer.release()
        away = read(tmp_path / name).astype(int) - stack()
        assert np.abs(away).mean() <= slack


def test_colours_are_refused_and_a_tint_is_not(tmp_path: Path) -> None:
    jet = np.stack([cv2.applyColorMap(image, cv2.COLORMAP_JET) for image in stack()])
    path = write(tmp_path / "a.mkv", "ffv1", "yuv444p", jet)
    assert "is a colour image" in complaint(path)
    warm = np.stack([stack(), stack(), np.maximum(stack(), 5) - 5], axis=-1)
    path = write(tmp_path / "b.mkv", "ffv1", "yuv444p", warm)
    assert np.abs(read(path).astype(int) - stack()).max() <= 6


@pytest.mark.parametrize(("degrees", "k"), [(90, 1), (-90, -1), (180, 2)])
def test_a_turned_video_is_shown_as_players_do(tmp_path: Path, degrees: int, k: int) -> None:
    def turn(stream: Any) -> None:
        stream.set_display_rotation(degrees)

    path = write(tmp_path / "x.mov", "png", "gray", stack(), turn)
    np.testing.assert_array_equal(read(path), np.rot90(stack(), k, (1, 2)))


# -- AVI without compression --------------------------------------------------------------------


def raw_avi(
    frames: Stack, bits: int, name: bytes = b"\0\0\0\0", bottom_up: bool = False, n: int = 0
) -> bytes:
    height, width = frames.shape[1:3]

    def chunk(kind: bytes, content: bytes) -> bytes:
        return kind + struct.pack("<I", len(content)) + content + b"\0" * (len(content) % 2)

    def parts(kind: bytes, name: bytes, content: bytes) -> bytes:
        return chunk(kind, name + content)

    stream = b"vids" + name + bytes(24) + struct.pack("<I", n or len(frames)) + bytes(20)
    size = height if bottom_up else -height
    head = struct.pack("<IiiHH4sIiiII", 40, width, size, 1, bits, name, 0, 0, 0, 0, 0)
    if bits == 8 and name == b"\0\0\0\0":
        head += np.repeat(np.arange(256, dtype=np.uint8), 4).tobytes()
    header = chunk(b"avih", bytes(56)) + parts(
        b"LIST", b"strl", chunk(b"strh", stream) + chunk(b"strf", head)
    )
    body = b""
    for image in frames:
        rows = image[::-1] if bottom_up else image
        lines = [row.tobytes() for row in rows]
        body += chunk(b"00db", b"".join(line + b"\0" * (-len(line) % 4) for line in lines))
    return parts(b"RIFF", b"AVI ", parts(b"LIST", b"hdrl", header) + parts(b"LIST", b"movi", body))


@pytest.mark.parametrize("bottom_up", [True, False])
@pytest.mark.parametrize(
    ("bits", "name"),
    [(8, b"\0\0\0\0"), (8, b"Y800"), (16, b"\0\0\0\0"), (16, b"Y16 "), (24, b"\0\0\0\0")],
)
def test_uncompressed_avi_is_read_without_any_decoder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, bits: int, name: bytes, bottom_up: bool
) -> None:
    monkeypatch.setitem(sys.modules, "av", None)
    if bottom_up and name != b"\0\0\0\0":
        pytest.skip("only bitmaps without a name come from below")
    frames = stack(bits=16 if bits == 16 else 8)
    stored = np.stack([frames] * 3, axis=-1) if bits == 24 else frames
    (tmp_path / "x.avi").write_bytes(raw_avi(stored, bits, name, bottom_up))
    read_back = read(tmp_path / "x.avi")
    assert read_back.dtype == frames.dtype
    np.testing.assert_array_equal(read_back, frames)


def test_uncompressed_avi_of_ffmpeg_keeps_16_bits(tmp_path: Path) -> None:
    frames = stack(bits=16)
    np.testing.assert_array_equal(
        read(write(tmp_path / "x.avi", "rawvideo", "gray16le", frames)), frames
    )


def test_an_avi_that_ends_early_is_told(tmp_path: Path) -> None:
    whole = raw_avi(stack(), 8)
    for cut in (20, 60, 200, 5000, len(whole) - 9):
        (tmp_path / "x.avi").write_bytes(whole[:cut])
        assert " can't be read (" in complaint(tmp_path / "x.avi")
    (tmp_path / "x.avi").write_bytes(raw_avi(stack(), 8, n=9))
    assert "ends too early, after 6 of 9 pictures" in complaint(tmp_path / "x.avi")


def test_a_small_avi_that_claims_to_be_large_is_refused(tmp_path: Path) -> None:
    data = bytearray(raw_avi(stack(1), 8))
    at = data.index(b"strf") + 12
    data[at : at + 8] = struct.pack("<ii", 90000, 90000)
    (tmp_path / "x.avi").write_bytes(data)
    assert "8100 Mpx), more than the 64 Mpx" in complaint(tmp_path / "x.avi")


# -- what is refused ----------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "codec", "kind"),
    [
        ("x.avi", "mjpeg", "yuvj420p"),
        ("x.mp4", "mpeg4", "yuv420p"),
        ("x.mp4", "libx264", "yuv420p"),
        ("x.mov", "png", "gray"),
    ],
)
@pytest.mark.parametrize("cut", [0.0, 0.02, 0.3, 0.8])
def test_a_video_that_ends_early_is_one_sentence(
    tmp_path: Path, name: str, codec: str, kind: str, cut: float
) -> None:
    path = write(tmp_path / name, codec, kind, stack(12))
    data = path.read_bytes()
    path.write_bytes(data[: int(cut * len(data))])
    assert " can't be read (" in complaint(path)


@pytest.mark.parametrize("name", ["x.avi", "x.mkv", "x.mov", "x.mjpeg"])
def test_other_bytes_are_one_sentence(tmp_path: Path, name: str) -> None:
    for content in (b"#EXTM3U\n/etc/passwd\n", b"RIFF\0\0\0\0AVI ", b"\xff\xd8\xff", b"\0" * 999):
        (tmp_path / name).write_bytes(content)
        assert " can't be read (" in complaint(tmp_path / name)


def test_damage_within_a_video_is_told_and_not_concealed(tmp_path: Path) -> None:
    path = write(tmp_path / "x.mp4", "libx264", "yuv420p", stack(12))
    data = bytearray(path.read_bytes())
    at = data.index(b"mdat") + 1200
    data[at : at + 400] = bytes(400)
    path.write_bytes(data)
    assert "can't be read (" in complaint(path)


def test_a_missing_decoder_is_called_so(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = write(tmp_path / "x.mp4", "mpeg4", "yuv420p", stack())
    monkeypatch.setitem(sys.modules, "av", None)
    said = complaint(path)
    assert "is a video, which needs a decoder that is not installed" in said
    assert "pip install 'pv-inspect[video]'" in said


def test_limits_hold_before_anything_is_decoded(tmp_path: Path) -> None:
    for path in (
        write(tmp_path / "x.mp4", "mpeg4", "yuv420p", stack()),
        write(tmp_path / "x.avi", "rawvideo", "gray", stack()),
    ):
        with pytest.raises(InspectionError, match=r"more than the 0\.001 Mpx"):
            expand(path, ReadLimits(max_frame_mpx=0.001))
        with pytest.raises(InspectionError, match="has more than 5 pictures"):
            expand(path, ReadLimits(max_frames=5))
