from __future__ import annotations

import json
import pickle
import threading
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
import tifffile
from numpy.typing import NDArray

from pv_inspect.errors import InspectionError
from pv_inspect.image_files.formats import FORMAT_NAMES
from pv_inspect.sequence.sequence import FrameSequence
from pv_inspect.settings import Settings

DATA = Path(__file__).parents[3] / "shared" / "data" / "sequences"
SHAPE = (96, 128)

Frames = list[NDArray[np.uint16]]


def make_frames(count: int = 5, shape: tuple[int, int] = SHAPE, seed: int = 0) -> Frames:
    """Frames of 12 bits in 16: black 64 DN, a bright smooth square that moves, noise."""
    rng = np.random.default_rng(seed)
    y, x = np.mgrid[: shape[0], : shape[1]]
    frames = []
    for i in range(count):
        inside = (np.abs(x - shape[1] / 2 - i) < shape[1] / 4) & (
            np.abs(y - shape[0] / 2) < shape[0] / 4
        )
        scene = 64.0 + 1800.0 * cv2.GaussianBlur(inside.astype(np.float64), (0, 0), 1.0)
        noisy = scene + rng.normal(0.0, 6.0, shape)
        frames.append(np.clip(np.rint(noisy), 0, 4095).astype(np.uint16))
    return frames


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    path = tmp_path / "sequence"
    write(path, make_frames())
    return path


def write(folder: Path, frames: Frames, suffix: str = ".tif") -> list[Path]:
    folder.mkdir(parents=True, exist_ok=True)
    paths = [folder / f"frame_{i}{suffix}" for i in range(len(frames))]
    for path, frame in zip(paths, frames, strict=True):
        if suffix == ".png":
            assert cv2.imwrite(str(path), frame)
        else:
            tifffile.imwrite(path, frame, compression="zlib")
    return paths


def complaint(action: Callable[[], object]) -> str:
    with pytest.raises(InspectionError) as caught:
        action()
    text = str(caught.value)
    assert "\n" not in text
    assert text.endswith(".")
    return text


# -- what can be opened ---------------------------------------------------------------------


@pytest.mark.parametrize("suffix", [".tif", ".png"])
def test_a_folder_is_read_in_natural_order(tmp_path: Path, suffix: str) -> None:
    frames = make_frames(12)
    write(tmp_path, frames, suffix)
    sequence = FrameSequence.open(tmp_path)
    assert sequence.names == tuple(f"frame_{i}{suffix}" for i in range(12))
    assert len(sequence) == 12
    assert sequence.shape == SHAPE
    for i in range(12):
        np.testing.assert_array_equal(sequence.raw(i), frames[i])


def test_pages_of_a_tiff_are_frames(tmp_path: Path) -> None:
    frames = make_frames(4)
    tifffile.imwrite(tmp_path / "stack.tif", np.stack(frames), photometric="minisblack")
    (tmp_path / "stack.json").write_text('{"rows": 3, "cols": 4}')
    sequence = FrameSequence.open(tmp_path / "stack.tif")
    assert sequence.names == tuple(f"stack.tif[{i}]" for i in range(4))
    assert sequence.layout_hint == {"rows": 3, "cols": 4}
    np.testing.assert_array_equal(sequence.raw(3), frames[3])
    np.testing.assert_array_equal(FrameSequence.open(tmp_path).raw(2), frames[2])


@pytest.mark.parametrize(
    "content", [b"II*\0 no picture", b"II*\0\0\0\0\0", b"II*\0\x08\0\0\0", b""]
)
def test_a_tiff_without_a_picture_is_refused_not_dropped(folder: Path, content: bytes) -> None:
    (folder / "frame_9.tif").write_bytes(content)
    with pytest.raises(InspectionError, match=r"frame_9\.tif can't be read"):
        FrameSequence.open(folder)


def test_a_list_keeps_its_order_and_tells_equal_names_apart(tmp_path: Path) -> None:
    a = write(tmp_path / "a", make_frames(2))
    b = write(tmp_path / "b", make_frames(2, seed=1))
    assert FrameSequence.open([a[1], str(a[0])]).names == ("frame_1.tif", "frame_0.tif")
    assert FrameSequence.open([a[0], b[0]]).names == ("a/frame_0.tif", "b/frame_0.tif")


def test_a_folder_with_a_frames_folder_opens_that(tmp_path: Path) -> None:
    write(tmp_path / "frames", make_frames(3))
    write(tmp_path / "truth", make_frames(1, shape=(40, 40)))
    (tmp_path / "module.json").write_text('{"rows": 6, "cols": 10, "cell_aspect": 2, "x": 1}')
    for source in (tmp_path, str(tmp_path), tmp_path / "frames"):
        sequence = FrameSequence.open(source)
        assert len(sequence) == 3
        assert sequence.layout_hint == {"rows": 6, "cols": 10, "cell_aspect": 2.0}


def test_what_is_no_frame_is_ignored(folder: Path) -> None:
    (folder / "module.json").write_text("{}")
    (folder / "Thumbs.db").write_bytes(b"x")
    (folder / ".hidden.tif").write_bytes(b"x")
    (folder / "notes.txt").write_text("x")
    (folder / "folder.tif").mkdir()
    assert len(FrameSequence.open(folder)) == 5


@pytest.mark.parametrize("kind", ["lzw", "big-endian", "inverted", "grey-rgb"])
def test_other_ways_of_storing_the_same_pixels_read_the_same(tmp_path: Path, kind: str) -> None:
    frame = make_frames(1)[0]
    path = tmp_path / "frame.tif"
    if kind == "lzw":
        assert cv2.imwrite(str(path), frame, [cv2.IMWRITE_TIFF_COMPRESSION, 5])
    elif kind == "big-endian":
        tifffile.imwrite(path, frame, byteorder=">")
    elif kind == "inverted":
        tifffile.imwrite(path, np.invert(frame), photometric="miniswhite")
    else:
        tifffile.imwrite(path, np.dstack([frame] * 3), photometric="rgb")
    raw = FrameSequence.open([path]).raw(0)
    np.testing.assert_array_equal(raw, frame)
    assert raw.dtype == np.uint16


# -- what is refused, in one sentence -------------------------------------------------------


def test_missing_and_empty_sources_are_named(tmp_path: Path) -> None:
    text = complaint(lambda: FrameSequence.open(tmp_path / "nowhere"))
    assert text == (
        f"{tmp_path / 'nowhere'} does not exist: give a folder of frames, a TIFF with several "
        "pages, or a list of images."
    )
    text = complaint(lambda: FrameSequence.open(tmp_path))
    assert text == (
        f"{tmp_path} holds no {FORMAT_NAMES} image: give the folder that the frames are in."
    )
    text = complaint(lambda: FrameSequence.open([]))
    assert text == "The list of frames is empty: give at least one image."


def test_files_of_a_list_are_checked(folder: Path) -> None:
    text = complaint(lambda: FrameSequence.open([folder / "frame_9.tif"]))
    assert "frame_9.tif is no existing file" in text
    (folder / "notes.txt").write_text("x")
    text = complaint(lambda: FrameSequence.open([folder / "notes.txt"]))
    assert f"notes.txt is no {FORMAT_NAMES} file" in text
    twice = [folder / "frame_1.tif", folder / "frame_0.tif", folder / "." / "frame_1.tif"]
    assert "frame_1.tif is in the list of frames twice" in complaint(
        lambda: FrameSequence.open(twice)
    )


@pytest.mark.parametrize("suffix", [".tif", ".png"])
@pytest.mark.parametrize("share", [0.0, 0.01, 0.5, 0.98])
def test_a_cut_file_is_named(
    tmp_path: Path, suffix: str, share: float, capfd: pytest.CaptureFixture[str]
) -> None:
    path = write(tmp_path, make_frames(3), suffix)[1]
    data = path.read_bytes()
    path.write_bytes(data[: int(share * len(data))])
    text = complaint(lambda: FrameSequence.open(tmp_path))
    assert text.startswith(f"frame_1{suffix} can't be read (")
    assert text.endswith("copy it again from the camera or remove it.")
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize("compression", ["zlib", "lzw", None])
def test_a_file_cut_in_its_pixels_or_damaged_is_named(
    tmp_path: Path, compression: str | None, capfd: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "frame.tif"
    frame = make_frames(1)[0]
    if compression == "lzw":
        assert cv2.imwrite(str(path), frame, [cv2.IMWRITE_TIFF_COMPRESSION, 5])
    else:
        tifffile.imwrite(path, frame, compression=compression)
    data = bytearray(path.read_bytes())
    if compression is None:
        data = data[:-100]
    else:
        data[3000:3200] = bytes(200)
    path.write_bytes(data)
    assert complaint(lambda: FrameSequence.open([path])).startswith("frame.tif can't be read (")
    assert capfd.readouterr() == ("", "")


def test_a_damaged_png_is_named(tmp_path: Path) -> None:
    path = write(tmp_path, make_frames(1), ".png")[0]
    data = bytearray(path.read_bytes())
    data[2000] ^= 1
    path.write_bytes(data)
    assert "(a checksum is wrong)" in complaint(lambda: FrameSequence.open(path))


def test_the_odd_one_out_is_named_for_its_size(tmp_path: Path) -> None:
    write(tmp_path, make_frames(4))
    tifffile.imwrite(tmp_path / "frame_0.tif", make_frames(1, shape=(80, 128))[0])
    assert complaint(lambda: FrameSequence.open(tmp_path)) == (
        "frame_0.tif is 128 x 80, the sequence is 128 x 96: remove it or load it as its own "
        "sequence."
    )


def test_the_odd_one_out_is_named_for_its_type(tmp_path: Path) -> None:
    write(tmp_path, make_frames(4))
    tifffile.imwrite(tmp_path / "frame_2.tif", np.zeros(SHAPE, np.uint8))
    assert complaint(lambda: FrameSequence.open(tmp_path)) == (
        "frame_2.tif has 8 bits, the sequence has 16: remove it or export all frames alike."
    )


@pytest.mark.parametrize("suffix", [".tif", ".png"])
def test_colour_is_refused(tmp_path: Path, suffix: str) -> None:
    grey = (make_frames(1)[0] >> 4).astype(np.uint8)
    colour = cv2.applyColorMap(grey, cv2.COLORMAP_JET)
    path = tmp_path / f"frame{suffix}"
    if suffix == ".png":
        assert cv2.imwrite(str(path), colour)
    else:
        tifffile.imwrite(path, colour, photometric="rgb")
    assert complaint(lambda: FrameSequence.open(tmp_path)) == (
        f"frame{suffix} is a colour image, but luminescence frames have one grey channel: export "
        "it as grey, without a colour map."
    )


def test_complex_values_are_refused(tmp_path: Path) -> None:
    tifffile.imwrite(tmp_path / "frame.tif", make_frames(1)[0].astype(np.complex64))
    assert complaint(lambda: FrameSequence.open(tmp_path)) == (
        "frame.tif holds complex64 values, but frames are whole or floating-point numbers: export "
        "what the camera delivered, without scaling."
    )


def test_tiny_frames_are_refused(tmp_path: Path) -> None:
    write(tmp_path, make_frames(2, shape=(20, 100)))
    assert complaint(lambda: FrameSequence.open(tmp_path)).startswith(
        "The frames are 100 x 20, too small to show a module"
    )


@pytest.mark.parametrize(
    ("content", "expected"),
    [
        ("{", "can't be read as JSON ("),
        ("[6, 10]", "holds no JSON object"),
        ('{"rows": "six"}', "rows is 'six', but a whole number from 1 to 200 is expected"),
        ('{"rows": true}', "rows is True, but a whole number"),
        ('{"cols": 0}', "cols is 0, but a whole number"),
        ('{"cell_aspect": 99}', "cell_aspect is 99, but cell width / cell height"),
        ('{"cell_aspect": NaN}', "it holds NaN, which is no number"),
    ],
)
def test_a_wrong_sidecar_is_named_with_its_key(folder: Path, content: str, expected: str) -> None:
    (folder / "module.json").write_text(content)
    text = complaint(lambda: FrameSequence.open(folder))
    assert str(folder / "module.json") in text
    assert expected in text


# -- layout ---------------------------------------------------------------------------------


def test_settings_win_over_the_sidecar(folder: Path) -> None:
    (folder / "module.json").write_text(json.dumps({"rows": 6, "cols": 10, "cell_aspect": 2}))
    layout = FrameSequence.open(folder).layout(Settings(cols=12))
    assert (layout.rows, layout.cols, layout.cell_aspect) == (6, 12, 2.0)


def test_an_unknown_layout_says_how_to_give_it(folder: Path) -> None:
    sequence = FrameSequence.open(folder)
    assert sequence.layout_hint == {}
    text = complaint(lambda: sequence.layout(Settings()))
    assert "The number of rows and cols of cells is unknown" in text
    assert "give --rows and --cols, or put a module.json" in text
    assert "give --cols, or" in complaint(lambda: sequence.layout(Settings(rows=6)))
    assert sequence.layout(Settings(rows=6, cols=10)).cell_aspect == 1.0


# -- pixels ---------------------------------------------------------------------------------


def test_intensities_are_black_subtracted_with_full_scale_one(folder: Path) -> None:
    sequence = FrameSequence.open(folder)
    frame = sequence.frame(0)
    assert (sequence.bit_depth, sequence.full_scale) == (12, 4095.0)
    assert sequence.black_level == pytest.approx(64.0, abs=4.0)
    assert frame.image.dtype == np.float32
    assert frame.valid.all()
    expected = (sequence.raw(0) - sequence.black_level) / (4095.0 - sequence.black_level)
    np.testing.assert_allclose(frame.image, expected, atol=1e-6)


def test_fixed_column_offsets_are_subtracted(tmp_path: Path) -> None:
    columns = np.random.default_rng(3).integers(0, 60, SHAPE[1]).astype(np.uint16)
    frames = make_frames(8, shape=(192, 128))
    write(tmp_path / "clean", frames)
    write(tmp_path / "streaked", [frame + columns for frame in frames])
    clean = FrameSequence.open(tmp_path / "clean").frame(4).image
    streaked = FrameSequence.open(tmp_path / "streaked").frame(4).image
    left = np.diff((streaked - clean).mean(axis=0)).std()
    assert left < 0.1 * np.diff(columns.astype(float)).std() / 4031


def test_saturated_pixels_are_invalid_and_keep_their_value(tmp_path: Path) -> None:
    frames = make_frames(4)
    frames[2][40:50, 60:70] = 4095
    write(tmp_path, frames)
    sequence = FrameSequence.open(tmp_path)
    frame = sequence.frame(2)
    np.testing.assert_array_equal(frame.valid, frames[2] < 4095)
    np.testing.assert_allclose(frame.image[40:50, 60:70], 1.0, atol=1e-6)
    assert sequence.frame(1).valid.all()


def test_hot_and_dead_pixels_are_invalid_and_filled(tmp_path: Path) -> None:
    frames = make_frames(6)
    clean = [f.copy() for f in frames]
    for f in frames:
        f[48, 64], f[10, 10], f[40, 70] = 0, 4095, 3000
    write(tmp_path, frames)
    sequence = FrameSequence.open(tmp_path)
    frame = sequence.frame(3)
    assert sorted(map(tuple, np.argwhere(~frame.valid).tolist())) == [(10, 10), (40, 70), (48, 64)]
    truth = (clean[3] - sequence.black_level) / (4095.0 - sequence.black_level)
    np.testing.assert_allclose(frame.image, truth, atol=0.01)


def test_a_dark_frame_is_subtracted_per_pixel_and_its_hot_pixels_are_flagged(
    tmp_path: Path,
) -> None:
    frames = make_frames(2)
    rng = np.random.default_rng(5)
    pattern = rng.integers(0, 200, SHAPE).astype(np.uint16)
    dark = pattern + np.uint16(64)
    frames = [f + pattern for f in frames]
    dark[20, 30] = 3900
    for f in frames:
        f[20, 30] = 3950
    write(tmp_path / "sequence", frames)
    tifffile.imwrite(tmp_path / "dark.tif", dark)
    sequence = FrameSequence.open(tmp_path / "sequence", dark_frame=tmp_path / "dark.tif")
    frame = sequence.frame(0)
    assert not frame.valid[20, 30]
    background = np.delete(frame.image[:15].ravel(), 0)
    assert abs(float(np.median(background))) < 0.002
    assert float(background.std()) == pytest.approx(6.0 / 4000, rel=0.1)


def test_a_wrong_dark_frame_is_refused(folder: Path, tmp_path: Path) -> None:
    tifffile.imwrite(tmp_path / "small.tif", np.zeros((96, 100), np.uint16))
    text = complaint(lambda: FrameSequence.open(folder, dark_frame=tmp_path / "small.tif"))
    assert "small.tif is 100 x 96 with 16 bits, the sequence is 128 x 96 with 16" in text
    tifffile.imwrite(tmp_path / "bright.tif", np.full(SHAPE, 3000, np.uint16))
    text = complaint(lambda: FrameSequence.open(folder, dark_frame=tmp_path / "bright.tif"))
    assert "bright.tif has a median of 3000 DN and is brighter than the frames" in text
    text = complaint(lambda: FrameSequence.open(folder, dark_frame=tmp_path / "none.tif"))
    assert "none.tif is no existing file" in text


def test_a_flat_frame_takes_the_fall_off_out_of_the_frames(tmp_path: Path) -> None:
    x = np.linspace(-1.0, 1.0, SHAPE[1])
    response = np.broadcast_to(1.0 - 0.4 * x**2, SHAPE)
    dark = np.full(SHAPE, 64, np.uint16)
    clean = make_frames(3)
    frames = [np.rint(64 + (f.astype(float) - 64) * response).astype(np.uint16) for f in clean]
    write(tmp_path / "even", clean)
    write(tmp_path / "falling", frames)
    tifffile.imwrite(tmp_path / "dark.tif", dark)
    flat = np.rint(64 + 3000 * response).astype(np.uint16)
    flat[30, 40] = 64
    tifffile.imwrite(tmp_path / "flat.tif", flat)
    even = FrameSequence.open(tmp_path / "even", tmp_path / "dark.tif").frame(1)
    found = FrameSequence.open(
        tmp_path / "falling", tmp_path / "dark.tif", flat_frame=tmp_path / "flat.tif"
    ).frame(1)
    assert not found.valid[30, 40]
    both = even.valid & found.valid
    lit = both & (even.image > 0.1)
    scale = float(np.median(found.image[lit] / even.image[lit]))
    assert scale == pytest.approx(float(np.median(response)), rel=0.01)
    np.testing.assert_allclose(found.image[both], scale * even.image[both], atol=6e-4)


def test_a_wrong_flat_frame_is_refused(folder: Path, tmp_path: Path) -> None:
    tifffile.imwrite(tmp_path / "small.tif", np.full((96, 100), 2000, np.uint16))
    text = complaint(lambda: FrameSequence.open(folder, flat_frame=tmp_path / "small.tif"))
    assert "The flat frame" in text
    assert "small.tif is 100 x 96 with 16 bits, the sequence is 128 x 96 with 16" in text
    tifffile.imwrite(tmp_path / "black.tif", np.zeros(SHAPE, np.uint16))
    text = complaint(lambda: FrameSequence.open(folder, flat_frame=tmp_path / "black.tif"))
    assert "black.tif is too dark" in text
    assert "take an evenly bright surface" in text
    text = complaint(lambda: FrameSequence.open(folder, flat_frame=tmp_path / "none.tif"))
    assert "none.tif is no existing file" in text


@pytest.mark.parametrize("value", [0, 17, 255])
def test_uniform_frames_open(tmp_path: Path, value: int) -> None:
    cv2.imwrite(str(tmp_path / "frame.png"), np.full(SHAPE, value, np.uint8))
    sequence = FrameSequence.open(tmp_path)
    frame = sequence.frame(0)
    assert np.isfinite(frame.image).all()
    assert frame.valid.all() == (value < 255)
    assert sequence.noise.read_variance > 0.0


# -- lazy, immutable, shared ----------------------------------------------------------------


def test_a_frame_is_read_when_asked_for_and_a_lost_file_is_named(folder: Path) -> None:
    sequence = FrameSequence.open(folder)
    (folder / "frame_3.tif").unlink()
    sequence.frame(2)
    assert complaint(lambda: sequence.frame(3)) == (
        "frame_3.tif is no longer there: put it back, or open the frames again."
    )


def test_frames_are_cached_and_read_only(folder: Path) -> None:
    sequence = FrameSequence.open(folder)
    frame = sequence.frame(1)
    assert sequence.frame(1) is frame
    assert sequence.frame(-4) is frame
    with pytest.raises(ValueError, match="read-only"):
        frame.image[0, 0] = 1.0
    with pytest.raises(IndexError):
        sequence.frame(5)


def test_it_pickles_without_frames(folder: Path) -> None:
    sequence = FrameSequence.open(folder)
    empty = len(pickle.dumps(sequence))
    for i in range(len(sequence)):
        sequence.frame(i)
    data = pickle.dumps(sequence)
    assert len(data) == empty
    copy = pickle.loads(data)
    assert copy.names == sequence.names
    np.testing.assert_array_equal(copy.frame(2).image, sequence.frame(2).image)


def test_threads_read_the_same_frames(tmp_path: Path) -> None:
    frames = make_frames(6)
    tifffile.imwrite(tmp_path / "stack.tif", np.stack(frames), photometric="minisblack")
    sequence = FrameSequence.open(tmp_path / "stack.tif")
    wrong: list[int] = []

    def read(seed: int) -> None:
        for i in np.random.default_rng(seed).integers(0, 6, 40).tolist():
            expected = (frames[i] - sequence.black_level) / (4095.0 - sequence.black_level)
            if np.abs(sequence.frame(i).image - expected).max() > 1e-5:
                wrong.append(i)

    threads = [threading.Thread(target=read, args=(seed,)) for seed in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert wrong == []


@pytest.mark.skipif(not DATA.is_dir(), reason="the simulated sequences are not beside the checkout")
@pytest.mark.parametrize("name", ["D1", "D2", "D6", "E1"])
def test_simulated_sequences_open_with_what_the_camera_is(name: str) -> None:
    truth = json.loads((DATA / name / "truth" / "truth.json").read_text())["noise"]
    sequence = FrameSequence.open(DATA / name)
    assert len(sequence) == 20
    assert (sequence.bit_depth, sequence.full_scale) == (12, 4095.0)
    # Ambient light lies on top of black: all that the frames can tell is an upper bound.
    assert truth["black_dn"] <= sequence.black_level < truth["black_dn"] + 0.04 * 4095
    expected = (truth["hot_share"] + truth["dead_share"]) * 640 * 512
    assert abs(sequence.defects.sum() - expected) < 4 * np.sqrt(expected)
    read = truth["read_noise_e"] / truth["full_well"]
    assert np.sqrt(sequence.noise.read_variance) == pytest.approx(read, rel=0.12)
    assert 0.9 < sequence.noise.shot_gain * truth["full_well"] < 1.7
