from __future__ import annotations

import base64
import re
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from pv_inspect.inspection.inspection import Inspection
from pv_inspect.reports.pictures import CRACK_RGB, blended, grey, jpeg_url
from pv_inspect.results.read import read_result
from pv_inspect.results.write import write_result
from pv_inspect.settings import Stage
from tests.handmade import REASON, made_inspection, made_reconstruction
from tests.reports.test_module_report import Reader


def html(shows_itself: object) -> str:
    page = shows_itself._repr_html_()  # type: ignore[attr-defined]
    assert isinstance(page, str)
    return page


def numbers(page: str) -> dict[str, str]:
    """Rows of the table."""
    rows = re.findall(r"<tr><th[^>]*>(.*?)</th><td[^>]*>(.*?)</td></tr>", page)
    return dict(rows)


def picture(page: str) -> np.ndarray:
    """The picture of the page, RGB."""
    (data,) = re.findall(r"data:image/jpeg;base64,([^\"]+)", page)
    bgr = cv2.imdecode(np.frombuffer(base64.b64decode(data), np.uint8), cv2.IMREAD_COLOR)
    return bgr[..., ::-1].astype(int)


def without(inspection: Inspection, *stages: str) -> Inspection:
    return replace(inspection, **dict.fromkeys(stages))


def test_the_numbers_are_those_of_the_inspection() -> None:
    assert numbers(html(made_inspection())) == {
        "cells": "cracks suspected in 1 of 6 cells, 5 clean",
        "module": "2 x 3 cells",
        "frames used": "2 of 3",
        "kappa": "-0.1000",
        "crossing points from the grid": "0.10 LR px",
        "image": "264 x 184 pixels, 4.00 x the frames",
        "residual": "1.10 x noise",  # median of 1.0 and 1.2
        "PSF sigma": "0.40 LR px",
        "lambda": "0.05",
    }


def test_the_crack_is_coloured_where_it_is_and_nothing_else_is() -> None:
    inspection = made_inspection()
    assert inspection.cracks is not None
    coloured = np.ptp(picture(html(inspection)), axis=2) > 60
    there = inspection.cracks.probability > 0.5
    near = cv2.dilate(there.astype(np.uint8), np.ones((9, 9))) > 0
    assert coloured[there].mean() > 0.9
    assert not coloured[~near].any()


def test_without_cracks_the_picture_is_grey() -> None:
    page = html(without(made_inspection(), "cracks"))
    assert np.ptp(picture(page), axis=2).max() <= 2  # rounding of JPEG's colours
    assert "cells" not in numbers(page)


def test_names_and_reasons_are_text_and_never_markup() -> None:
    page = html(made_inspection())
    assert "<b>found" not in page
    assert "<7>" not in page
    text = Reader(page).text
    assert REASON in text
    assert "module <7>" in text
    assert "frame_1 & <i>.tif" in text


def test_a_partial_inspection_shows_what_there_is_and_says_what_is_missing() -> None:
    whole = made_inspection(warnings=())
    late = ("reconstruction", "tiles", "cracks")
    registered = without(whole, *late)
    page = html(registered)
    assert "Still to run: reconstruct, cells, cracks." in page
    assert "<img" not in page
    assert numbers(page)["registration residual"] == "1.25 x noise"
    assert "residual" not in numbers(page)
    found = html(without(registered, "registration", "calibration"))
    assert numbers(found) == {"module": "2 x 3 cells", "module found in": "3 of 3 frames"}
    nothing = html(without(registered, "registration", "calibration", "crossings"))
    assert numbers(nothing) == {"module": "2 x 3 cells"}
    assert f"Still to run: {', '.join(list(Stage)[1:])}." in nothing
    assert "Still to run" not in html(whole)


def test_a_guessed_layout_says_so() -> None:
    page = html(made_inspection(layout_guessed=True))
    assert numbers(page)["module"] == "2 x 3 cells, guessed"


def test_of_many_warnings_the_first_are_shown_and_the_others_counted() -> None:
    page = html(made_inspection(warnings=tuple(f"warning {i}." for i in range(12))))
    assert page.count("<li>warning") == 5
    assert "<li>and 7 more</li>" in page


def test_the_page_of_a_large_noisy_module_stays_small() -> None:
    inspection = made_inspection()
    small = made_reconstruction()
    noise = np.random.default_rng(0).random((1800, 3000), dtype=np.float32)
    large = replace(small, image=noise, grid=replace(small.grid, shape=noise.shape))
    page = html(replace(without(inspection, "cracks", "tiles"), reconstruction=large))
    assert len(page) < 400_000


def test_a_result_that_was_read_shows_the_same_picture_and_numbers(tmp_path: Path) -> None:
    inspection = made_inspection()
    write_result(inspection, tmp_path / "my <result>")
    result = read_result(tmp_path / "my <result>")
    page, origin = html(result), html(inspection)
    assert "<result>" not in page
    expected = numbers(origin)
    del expected["crossing points from the grid"]  # not kept in the result folder
    assert numbers(page) == expected
    np.testing.assert_array_equal(picture(page), picture(origin))
    assert Reader(page).text.count(REASON) == 1


def test_as_text_they_are_one_line(tmp_path: Path) -> None:
    assert repr(without(made_inspection(), "reconstruction", "tiles", "cracks")) == (
        "<Inspection of 'somewhere/module <7>': 2 x 3 cells; done: detect, calibrate, register>"
    )
    write_result(made_inspection(), tmp_path / "out")
    assert repr(read_result(tmp_path / "out")).endswith(
        "out': 2 x 3 cells; done: register, reconstruct, cells, cracks>"
    )


@pytest.mark.parametrize("alpha", [0, 51, 255])
def test_blending_is_the_weighted_mean_of_picture_and_overlay(alpha: int) -> None:
    picture = grey(np.array([[0.0, 0.5, 1.0]], np.float32), 0.0, 1.0)
    overlay = np.empty((1, 3, 4), np.uint8)
    overlay[..., :3], overlay[..., 3] = CRACK_RGB, alpha
    share = alpha / 255
    expected = (1 - share) * picture[..., None] + share * np.array(CRACK_RGB)
    np.testing.assert_allclose(blended(picture, overlay), expected, atol=0.5)


def test_a_jpeg_keeps_the_order_of_its_colours() -> None:
    flat = np.full((16, 16, 3), CRACK_RGB, np.uint8)
    np.testing.assert_allclose(picture(jpeg_url(flat) + '"'), flat, atol=4)
