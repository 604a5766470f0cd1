"""Files that hold a whole sequence: arrays and videos, for the mutations to start from."""

from __future__ import annotations

import io
from contextlib import suppress
from functools import cache
from typing import Any

import numpy as np

from tests.fuzz.seeds import HEIGHT, WIDTH, picture

__all__ = ["array_files", "videos"]


@cache
def array_files() -> dict[str, bytes]:
    """Stacks of NumPy, FITS and HDF5, plain, packed and with several arrays, by their names."""
    stack = np.stack([picture(k) for k in range(3)])
    narrow = np.stack([picture(k, 250, np.uint8) for k in range(3)])
    found: dict[str, bytes] = {}
    for name, array in (("a", stack), ("b", narrow), ("c", (stack / 7).astype(np.float32))):
        buffer = io.BytesIO()
        np.save(buffer, np.asfortranarray(array) if name == "b" else array)
        found[f"{name}.npy"] = buffer.getvalue()
    for name, save in (("a", np.savez), ("b", np.savez_compressed)):
        buffer = io.BytesIO()
        save(buffer, frames=stack, dark=stack[0], other=narrow)
        found[f"{name}.npz"] = buffer.getvalue()
    with suppress(ImportError):
        from astropy.io import fits

        units: list[Any] = [fits.PrimaryHDU(stack), fits.ImageHDU(stack[0], name="dark")]
        packed: list[Any] = [fits.PrimaryHDU(), fits.CompImageHDU(stack)]
        floats: list[Any] = [fits.PrimaryHDU(stack.astype(np.float32))]
        for name, hdus in (("a", units), ("b", packed), ("c", floats)):
            buffer = io.BytesIO()
            fits.HDUList(hdus).writeto(buffer)
            found[f"{name}.fits"] = buffer.getvalue()
    with suppress(ImportError):
        import h5py

        for name, how in (("a", {}), ("b", {"chunks": (1, HEIGHT, 16), "compression": "gzip"})):
            buffer = io.BytesIO()
            with h5py.File(buffer, "w") as file:
                file.create_dataset("entry/data", data=stack, **how)
                file["entry/dark"] = stack[0]
                file["entry/other"] = narrow
            found[f"{name}.h5"] = buffer.getvalue()
    return found


@cache
def videos() -> dict[str, bytes]:
    """Short videos, compressed and not, by their names."""
    with suppress(ImportError):
        import av

        found = {}
        for name, codec, kind in (
            ("a.avi", "mjpeg", "yuvj420p"),
            ("b.avi", "rawvideo", "gray16le"),
            ("c.avi", "rawvideo", "bgr24"),
            ("a.mp4", "mpeg4", "yuv420p"),
            ("b.mp4", "libx264", "yuv420p"),
            ("a.mkv", "ffv1", "gray16le"),
            ("b.mkv", "ffv1", "yuv444p"),
            ("a.mov", "png", "gray"),
            ("a.mjpeg", "mjpeg", "yuvj420p"),
        ):
            buffer = io.BytesIO()
            form = {"mkv": "matroska", "mjpeg": "mjpeg"}.get(name[2:], name[2:])
            with av.open(buffer, "w", format=form) as container:
                stream = container.add_stream(codec, rate=10)
                stream.height, stream.width, stream.pix_fmt = HEIGHT, WIDTH, kind
                for k in range(4):
                    image = av.VideoFrame.from_ndarray(picture(k, 250, np.uint8), format="gray")
                    image = image.reformat(format=kind)
                    image.pts = k
                    container.mux(stream.encode(image))
                container.mux(stream.encode(None))
            found[name] = buffer.getvalue()
        return found
    return {}
