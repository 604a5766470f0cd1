"""NumPy, FITS and HDF5: the same frames, however they lie in their files."""

from __future__ import annotations

import builtins
import io
import subprocess
import sys
import tracemalloc
import warnings
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from pv_inspect.errors import InspectionError
from pv_inspect.image_files.limits import ReadLimits
from pv_inspect.sequence.frame_files import expand, expand_with_notes, read_frame
from pv_inspect.sequence.sequence import FrameSequence
from tests.image_files.making import scene

Array = NDArray[Any]


def stack(n: int = 5, dtype: str = "uint16", shape: tuple[int, int] = (40, 50)) -> Array:
    return np.stack([(scene("uint16", shape) // 16 + k).astype(dtype) for k in range(n)])


def npy(path: Path, array: Array) -> Path:
    np.save(path, array)
    return path


def npz(path: Path, array: Array) -> Path:
    np.savez_compressed(path, frames=array)
    return path


def fits_of(path: Path, array: Array) -> Path:
    fits = pytest.importorskip("astropy.io.fits")
    fits.writeto(path, array)
    return path


def hdf5(path: Path, array: Array) -> Path:
    h5py = pytest.importorskip("h5py")
    with h5py.File(path, "w") as file:
        chunks = (1, *array.shape[1:]) if array.ndim > 2 and array.size else None
        packed = "gzip" if chunks else None
        file.create_dataset("entry/data", data=array, chunks=chunks, compression=packed)
    return path


WRITERS: dict[str, Callable[[Path, Array], Path]] = {
    "npy": npy,
    "npz": npz,
    "fits": fits_of,
    "h5": hdf5,
}
every_format = pytest.mark.parametrize("ending", WRITERS)


def read(path: Path, series: str | None = None) -> Array:
    return np.stack([read_frame(file) for file in expand(path, series=series)])


def complaint(path: Path, series: str | None = None) -> str:
    with pytest.raises(InspectionError) as caught:
        read(path, series)
    said = str(caught.value)
    assert len(said) < 400
    assert said.startswith(path.name)
    return said


# -- the same pixels ----------------------------------------------------------------------------


@every_format
@pytest.mark.parametrize("dtype", ["uint8", "uint16", "int16", "int32", "float32", "float64"])
def test_a_stack_is_read_frame_by_frame(tmp_path: Path, ending: str, dtype: str) -> None:
    array = stack(dtype=dtype)
    path = WRITERS[ending](tmp_path / f"x.{ending}", array)
    files = expand(path)
    assert [file.label("x") for file in files] == [f"x[{k}]" for k in range(5)]
    assert all(file.dtype == dtype for file in files)
    np.testing.assert_array_equal(read(path), array)
    for k in (3, 0, 4, 4, 1):  # in any order
        np.testing.assert_array_equal(read_frame(files[k]), array[k])


@every_format
@pytest.mark.parametrize(
    ("arrange", "n"),
    [
        (lambda a: a[0], 1),
        (lambda a: a[:, None], 5),
        (lambda a: a[None], 5),
        (lambda a: np.moveaxis(a, 0, -1), 5),
        (lambda a: np.asfortranarray(a), 5),
        (lambda a: a[..., None], 5),
        (lambda a: np.stack([a[0]] * 3, axis=-1), 1),
        (lambda a: np.stack([a] * 3, axis=-1), 5),
    ],
)
def test_axes_are_told_apart(
    tmp_path: Path, ending: str, arrange: Callable[[Array], Array], n: int
) -> None:
    path = WRITERS[ending](tmp_path / f"x.{ending}", arrange(stack()))
    np.testing.assert_array_equal(read(path), stack()[:n])


@every_format
def test_the_other_byte_order_is_read(tmp_path: Path, ending: str) -> None:
    for order in "<>":
        path = tmp_path / f"{'a' if order == '<' else 'b'}.{ending}"
        array = stack().astype(stack().dtype.newbyteorder(order))
        np.testing.assert_array_equal(read(WRITERS[ending](path, array)), stack())


@every_format
def test_a_stack_opens_as_a_sequence_alone_or_in_a_folder(tmp_path: Path, ending: str) -> None:
    path = WRITERS[ending](tmp_path / f"x.{ending}", stack())
    (tmp_path / "module.json").write_text('{"rows": 2, "cols": 3}')
    for source in (path, tmp_path):
        sequence = FrameSequence.open(source)
        assert (len(sequence), sequence.layout_hint) == (5, {"rows": 2, "cols": 3})
        np.testing.assert_array_equal(sequence.raw(3), stack()[3])


def test_frames_saved_one_by_one_are_a_folder_of_frames(tmp_path: Path) -> None:
    for k in range(5):
        np.save(tmp_path / f"f_{k}.npy", stack()[k])
    assert FrameSequence.open(tmp_path).names == tuple(f"f_{k}.npy" for k in range(5))


def test_a_stack_beside_images_is_no_frame(tmp_path: Path) -> None:
    tifffile = pytest.importorskip("tifffile")
    for k in range(5):
        tifffile.imwrite(tmp_path / f"f_{k}.tif", stack()[k])
    np.savez(tmp_path / "trials.npz", a=stack())
    assert len(FrameSequence.open(tmp_path)) == 5


# -- several arrays -----------------------------------------------------------------------------


def several(path: Path, **arrays: Array) -> Path:
    if path.suffix == ".npz":
        np.savez(path, **arrays)
    elif path.suffix == ".h5":
        h5py = pytest.importorskip("h5py")
        with h5py.File(path, "w") as file:
            for name, array in arrays.items():
                file[name] = array
    else:
        fits = pytest.importorskip("astropy.io.fits")
        units = [fits.ImageHDU(array, name=name) for name, array in arrays.items()]
        fits.HDUList([fits.PrimaryHDU(), *units]).writeto(path)
    return path


several_arrays = pytest.mark.parametrize("ending", ["npz", "h5", "fits"])


@several_arrays
def test_dark_and_flat_frames_and_numbers_beside_the_frames_are_left_out(
    tmp_path: Path, ending: str
) -> None:
    path = several(tmp_path / f"x.{ending}", dark=stack()[0], frames=stack(), times=np.arange(5.0))
    files, (note,) = expand_with_notes(path, ReadLimits())
    assert len(files) == 5
    np.testing.assert_array_equal(read(path), stack())
    assert "1 of 50 x 40 px, uint16" in note
    assert "dark" in note.lower()


@several_arrays
def test_frames_as_arrays_of_their_own_are_one_series(tmp_path: Path, ending: str) -> None:
    frames = {f"f{k}": image for k, image in enumerate(stack(12))}
    np.testing.assert_array_equal(read(several(tmp_path / f"x.{ending}", **frames)), stack(12))


@several_arrays
def test_of_several_stacks_one_has_to_be_chosen(tmp_path: Path, ending: str) -> None:
    other = stack(3, shape=(36, 44))
    path = several(tmp_path / f"x.{ending}", LEFT=stack(), RIGHT=other)
    said = complaint(path)
    assert "holds 2 series of pictures, 1 '" in said
    assert "LEFT' (5 of 50 x 40 px, uint16), 2 '" in said
    assert "--series" in said
    np.testing.assert_array_equal(read(path, "2"), other)
    name = "3 RIGHT" if ending == "fits" else "RIGHT"
    np.testing.assert_array_equal(read(path, name), other)


# -- what is refused ----------------------------------------------------------------------------


class _Evil:
    def __reduce__(self) -> tuple[Any, tuple[str]]:
        return builtins.exec, ("raise SystemExit('a pickle was loaded')",)


def test_python_objects_are_never_loaded(tmp_path: Path) -> None:
    evil = np.array([_Evil()], dtype=object)
    np.save(tmp_path / "x.npy", evil, allow_pickle=True)
    assert "holds Python objects, which are not read" in complaint(tmp_path / "x.npy")
    np.savez(tmp_path / "x.npz", a=evil, allow_pickle=True)
    assert "holds Python objects, which are not read" in complaint(tmp_path / "x.npz")
    np.savez(tmp_path / "y.npz", a=evil, frames=stack(), allow_pickle=True)
    np.testing.assert_array_equal(read(tmp_path / "y.npz"), stack())


@every_format
@pytest.mark.parametrize(
    "array", [np.zeros((0, 40, 50)), np.zeros(7), np.zeros((2, 3, 40, 50), np.uint16)]
)
def test_what_is_no_stack_of_pictures_is_told(tmp_path: Path, ending: str, array: Array) -> None:
    if ending == "fits" and not array.size:
        pytest.skip("FITS has no empty images")
    said = complaint(WRITERS[ending](tmp_path / f"x.{ending}", array))
    assert "holds no pictures" in said


@every_format
@pytest.mark.parametrize("cut", [0.0, 0.01, 0.3, 0.7, 0.99])
def test_a_file_that_ends_early_is_one_sentence(tmp_path: Path, ending: str, cut: float) -> None:
    path = WRITERS[ending](tmp_path / f"x.{ending}", stack(12))
    data = path.read_bytes()
    path.write_bytes(data[: int(cut * len(data)) - (3000 if cut == 0.99 else 0)])
    assert " can't be read (" in complaint(path)


@every_format
def test_other_bytes_are_one_sentence(tmp_path: Path, ending: str) -> None:
    path = tmp_path / f"x.{ending}"
    path.write_bytes(b"\x89PNG\r\n\x1a\n" * 500)
    assert " can't be read (" in complaint(path)


@every_format
def test_a_file_that_changed_is_told(tmp_path: Path, ending: str) -> None:
    path = WRITERS[ending](tmp_path / f"x.{ending}", stack())
    files = expand(path)
    read_frame(files[1])
    path.write_bytes(path.read_bytes() + b"x")
    with pytest.raises(InspectionError, match="has changed since it was opened"):
        read_frame(files[2])


@every_format
def test_limits_hold_before_anything_is_read(tmp_path: Path, ending: str) -> None:
    path = WRITERS[ending](tmp_path / f"x.{ending}", stack())
    with pytest.raises(InspectionError, match=r"more than the 0\.001 Mpx"):
        expand(path, ReadLimits(max_frame_mpx=0.001))
    with pytest.raises(InspectionError, match="has 5 pictures, more than the 4"):
        expand(path, ReadLimits(max_frames=4))


def test_headers_that_promise_too_much_take_no_memory(tmp_path: Path) -> None:
    header = b"{'descr': '<u2', 'fortran_order': False, 'shape': (4, 90000, 90000), }"
    huge = b"\x93NUMPY\x01\x00" + len(header).to_bytes(2, "little") + header
    long = b"\x93NUMPY\x02\x00" + (2**31).to_bytes(4, "little")
    tracemalloc.start()
    for name, content in (("a", huge + bytes(1000)), ("b", long)):
        (tmp_path / f"{name}.npy").write_bytes(content)
        assert "can't be read (" in complaint(tmp_path / f"{name}.npy")
        with zipfile.ZipFile(tmp_path / f"{name}.npz", "w", zipfile.ZIP_DEFLATED) as archive:
            archive.writestr("x.npy", content + b" " * 2**20)
    assert "8100 Mpx), more than the 64 Mpx" in complaint(tmp_path / "a.npz")
    assert "its header has 2147483648 bytes" in complaint(tmp_path / "b.npz")
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 2**23


def test_an_archive_of_zeros_is_refused_by_what_it_unfolds_to(tmp_path: Path) -> None:
    header = b"{'descr': '<u2', 'fortran_order': True, 'shape': (900, 3000, 3000), }"
    head = b"\x93NUMPY\x01\x00" + len(header).to_bytes(2, "little") + header
    with zipfile.ZipFile(tmp_path / "x.npz", "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("x.npy", head + bytes(2**20))
    with pytest.raises(InspectionError, match="unfold from"):
        FrameSequence.open(tmp_path / "x.npz")
    assert "has to be read as a whole" in complaint(tmp_path / "x.npz")


def test_a_stream_that_is_left_open_ends_without_a_word(tmp_path: Path) -> None:
    path = npz(tmp_path / "x.npz", stack())
    code = (
        "from pathlib import Path; from pv_inspect.sequence.frame_files import expand, read_frame; "
        f"read_frame(expand(Path({str(path)!r}))[1])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert (done.stdout, done.stderr) == ("", "")


def test_a_header_of_python_2_is_read_without_a_word(tmp_path: Path) -> None:
    buffer = io.BytesIO()
    np.save(buffer, stack())
    data = buffer.getvalue().replace(b"(5, 40, 50)", b"(5L, 40, 50)", 1)
    at = data.index(b"\n")
    (tmp_path / "x.npy").write_bytes(data[: at - 1] + data[at:])
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        np.testing.assert_array_equal(read(tmp_path / "x.npy"), stack())


@pytest.mark.parametrize(
    ("ending", "module", "package"),
    [("fits", "astropy.io", "fits"), ("h5", "h5py", "hdf5")],
)
def test_a_missing_decoder_is_called_so(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, ending: str, module: str, package: str
) -> None:
    monkeypatch.setitem(sys.modules, module, None)
    (tmp_path / f"x.{ending}").write_bytes(b"whatever")
    said = complaint(tmp_path / f"x.{ending}")
    assert "needs a decoder that is not installed" in said
    assert f"pip install 'pv-inspect[{package}]'" in said


# -- FITS ---------------------------------------------------------------------------------------


def test_unsigned_scaled_and_blank_values_of_fits(tmp_path: Path) -> None:
    fits = pytest.importorskip("astropy.io.fits")
    path = fits_of(tmp_path / "a.fits", stack())  # stored with BZERO
    assert expand(path)[0].dtype == np.uint16
    unit = fits.PrimaryHDU(stack(dtype="int16"))
    unit.header["BLANK"] = int(stack()[0, 3, 4])
    unit.writeto(tmp_path / "b.fits")
    (first, *_) = expand(tmp_path / "b.fits")
    assert first.dtype == np.float32
    frame = read_frame(first)
    assert np.isnan(frame[3, 4])
    np.testing.assert_array_equal(frame[10:], np.where(np.isnan(frame), np.nan, stack()[0])[10:])
    unit = fits.PrimaryHDU(stack(dtype="float32"))
    unit.scale("int16", bscale=0.5, bzero=100)
    unit.writeto(tmp_path / "c.fits")
    np.testing.assert_allclose(read(tmp_path / "c.fits"), stack(), atol=0.5)


def test_packed_images_of_fits_are_read(tmp_path: Path) -> None:
    fits = pytest.importorskip("astropy.io.fits")
    for kind in ("RICE_1", "GZIP_1"):
        units = [fits.CompImageHDU(image, compression_type=kind) for image in stack()]
        fits.HDUList([fits.PrimaryHDU(), *units]).writeto(tmp_path / f"{kind}.fits")
        np.testing.assert_array_equal(read(tmp_path / f"{kind}.fits"), stack())


def test_rows_from_below_are_turned_and_said(tmp_path: Path) -> None:
    fits = pytest.importorskip("astropy.io.fits")
    for order in ("TOP-DOWN", "BOTTOM-UP"):
        unit = fits.PrimaryHDU(stack())
        unit.header["ROWORDER"] = order
        unit.writeto(tmp_path / f"{order}.fits")
    np.testing.assert_array_equal(read(tmp_path / "TOP-DOWN.fits"), stack())
    np.testing.assert_array_equal(read(tmp_path / "BOTTOM-UP.fits"), stack()[:, ::-1])
    said = FrameSequence.open(tmp_path / "BOTTOM-UP.fits").warnings
    assert any("mirrored top to bottom" in text for text in said)


# -- HDF5 ---------------------------------------------------------------------------------------


def test_hdf5_never_leads_out_of_its_file(tmp_path: Path) -> None:
    h5py = pytest.importorskip("h5py")
    hdf5(tmp_path / "other.h5", stack())
    (tmp_path / "raw.bin").write_bytes(stack().tobytes())
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["link"] = h5py.ExternalLink(str(tmp_path / "other.h5"), "/entry/data")
        file["soft"] = h5py.SoftLink("/nowhere")
    assert "holds no pictures" in complaint(tmp_path / "a.h5")
    with h5py.File(tmp_path / "b.h5", "w") as file:
        file.create_dataset(
            "x", (5, 40, 50), "u2", external=[(str(tmp_path / "raw.bin"), 0, 20_000)]
        )
    assert "names other files" in complaint(tmp_path / "b.h5")
    layout = h5py.VirtualLayout((5, 40, 50), "u2")
    layout[:] = h5py.VirtualSource(str(tmp_path / "other.h5"), "entry/data", (5, 40, 50))
    with h5py.File(tmp_path / "c.h5", "w") as file:
        file.create_virtual_dataset("x", layout)
    assert "names other files" in complaint(tmp_path / "c.h5")


def test_a_missing_filter_of_hdf5_is_called_a_missing_decoder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    h5py = pytest.importorskip("h5py")
    path = hdf5(tmp_path / "x.h5", stack())
    monkeypatch.setattr(h5py.h5z, "filter_avail", lambda _: False)
    assert "is packed with deflate, which needs a decoder that is not installed" in complaint(path)


def test_a_block_that_is_too_large_is_refused(tmp_path: Path) -> None:
    h5py = pytest.importorskip("h5py")
    with h5py.File(tmp_path / "x.h5", "w") as file:
        file.create_dataset("x", (900, 500, 600), "u2", chunks=(900, 500, 600), compression="gzip")
    assert "packed in blocks that are too large" in complaint(tmp_path / "x.h5")
