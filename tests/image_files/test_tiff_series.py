from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tifffile
from numpy.typing import NDArray

from pv_inspect.errors import InspectionError
from pv_inspect.image_files.limits import ReadLimits
from pv_inspect.sequence.frame_files import expand, expand_with_notes, read_frame
from tests.image_files.making import scene

Stack = NDArray[np.uint16]


def stack(n: int, shape: tuple[int, int] = (40, 50), start: int = 0) -> Stack:
    return np.stack([scene("uint16", shape) + np.uint16(start + k) for k in range(n)])


def read(path: Path, series: str | None = None) -> Stack:
    return np.stack([read_frame(file) for file in expand(path, series=series)])


def write(path: Path, *series: Any, names: tuple[str, ...] = (), **how: Any) -> Path:
    with tifffile.TiffWriter(path, **how) as writer:
        for k, images in enumerate(series):
            colour = images.shape[-1] == 3
            metadata = {"Name": names[k]} if names else None
            if how.get("ome") or metadata is None:
                writer.write(
                    images, photometric="rgb" if colour else "minisblack", metadata=metadata or {}
                )
    return path


# -- one header for all -------------------------------------------------------------------------


def test_a_truncated_stack_of_tifffile_is_read_whole(tmp_path: Path) -> None:
    path = tmp_path / "x.tif"
    tifffile.imwrite(path, stack(5), truncate=True)
    np.testing.assert_array_equal(read(path), stack(5))


def test_a_stack_that_promises_more_than_its_pages_is_told(tmp_path: Path) -> None:
    note = "ImageJ=1.11a\nimages=7\n"
    with tifffile.TiffWriter(tmp_path / "x.tif") as writer:
        for image in stack(3):
            writer.write(image, description=note, metadata=None)
            note = ""
    with pytest.raises(InspectionError, match="says that it has 7 pictures, but has 3 pages"):
        expand(tmp_path / "x.tif")


def test_too_many_pictures_in_one_header_are_refused(tmp_path: Path) -> None:
    tifffile.imwrite(tmp_path / "x.tif", stack(5), truncate=True)
    with pytest.raises(InspectionError, match="has 5 pictures, more than the 4"):
        expand(tmp_path / "x.tif", ReadLimits(max_frames=4))


# -- a label beside the frames ------------------------------------------------------------------


@pytest.mark.parametrize("ome", [True, False])
def test_a_label_page_is_left_out_and_said(tmp_path: Path, ome: bool) -> None:
    label = np.random.default_rng(0).integers(0, 255, (30, 90, 3), np.uint8)
    path = write(tmp_path / "x.tif", stack(4), label, ome=ome)
    files, notes = expand_with_notes(path, ReadLimits())
    assert [file.label("x.tif") for file in files] == [f"x.tif[{k}]" for k in range(4)]
    np.testing.assert_array_equal(read(path), stack(4))
    (note,) = notes
    assert note.startswith("x.tif holds other pictures as well, which are left out (")
    assert "1 of 90 x 30 px, colour" in note


def test_a_label_before_the_frames_or_like_a_frame_is_left_out(tmp_path: Path) -> None:
    path = write(tmp_path / "a.tif", stack(1, (20, 30)), stack(4), ome=True)
    np.testing.assert_array_equal(read(path), stack(4))
    path = write(
        tmp_path / "b.tif", stack(4), stack(1, start=9), names=("EL", "label image"), ome=True
    )
    files, notes = expand_with_notes(path, ReadLimits())
    assert len(files) == 4
    assert "label image, 1 of 50 x 40 px, uint16" in notes[0]


def test_frames_that_were_written_one_by_one_are_one_series(tmp_path: Path) -> None:
    for k, how in enumerate(({}, {"ome": True})):
        path = write(tmp_path / f"{k}.tif", *stack(5), **how)
        files, notes = expand_with_notes(path, ReadLimits())
        assert len(files) == 5
        assert not notes
        np.testing.assert_array_equal(read(path), stack(5))


# -- several series -----------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("second", "how"),
    [
        (stack(3, start=50), {"ome": True}),
        (stack(3, start=50), {}),
        (stack(3, (20, 30)), {"ome": True}),
        (stack(3, (20, 30)), {}),
    ],
)
def test_of_several_series_one_has_to_be_chosen(
    tmp_path: Path, second: Stack, how: dict[str, Any]
) -> None:
    path = write(tmp_path / "x.tif", stack(4), second, **how)
    with pytest.raises(InspectionError) as caught:
        expand(path)
    said = str(caught.value)
    assert said.startswith("x.tif holds 2 series of pictures, 1")
    assert "(4 of 50 x 40 px, uint16), 2" in said
    assert said.endswith(
        "choose one by number or name with --series, or Series on the page Frames."
    )
    assert len(said) < 400
    np.testing.assert_array_equal(read(path, "1"), stack(4))
    np.testing.assert_array_equal(read(path, "2"), second)
    with pytest.raises(InspectionError, match="holds no series '3' but 2 series of pictures"):
        expand(path, series="3")


def test_a_series_is_chosen_by_its_name(tmp_path: Path) -> None:
    second = stack(3, start=50)
    path = write(tmp_path / "x.tif", stack(4), second, names=("left", "right"), ome=True)
    with pytest.raises(InspectionError, match=r"1 'left' \(4 of .*2 'right' \(3 of"):
        expand(path)
    np.testing.assert_array_equal(read(path, "right"), second)


@pytest.mark.parametrize(
    "note",
    [
        "<OME><Image>",
        "<OME><Image/><Pixels SizeT='9999999999'/></OME>",
        "<!DOCTYPE a [<!ENTITY b 'c'>]><OME><Image Name='&b;'/></OME>",
        "<OME " + "<Image " * 20_000,
        '{"shape": [' + "[" * 4000,
        '{"shape": [-1, 3]}',
        '{"shape": 7, "truncated": true}',
        '{"shape": [1e99, 2], "truncated": true}',
    ],
)
def test_notes_that_are_broken_are_ignored(tmp_path: Path, note: str) -> None:
    with tifffile.TiffWriter(tmp_path / "x.tif") as writer:
        for k, image in enumerate(stack(3)):
            writer.write(image, description=note if k == 0 else None, metadata=None)
    np.testing.assert_array_equal(read(tmp_path / "x.tif"), stack(3))
