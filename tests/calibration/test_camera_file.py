from __future__ import annotations

import json
from contextlib import suppress
from pathlib import Path
from time import process_time
from typing import Any

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pv_inspect.calibration.camera_file import read_camera
from pv_inspect.calibration.opencv_text import xml_entries, yaml_entries
from pv_inspect.errors import InspectionError

SHAPE = (512, 640)
K = np.array([[800.0, 0, 313.5], [0, 802.0, 260.5], [0, 0, 1]])
ROS = """image_width: 640
image_height: 512
camera_name: thermal
camera_matrix:
  rows: 3
  cols: 3
  data: [800, 0, 313.5, 0, 802, 260.5, 0, 0, 1]
distortion_coefficients:
  rows: 1
  cols: 5
  data: [-0.2, 0, 0, 0, 0]
"""


def opencv_file(path: Path, distortion: list[float] | None, **more: int) -> Path:
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
    for name, value in more.items():
        storage.write(name, value)
    storage.write("camera_matrix", K)
    if distortion is not None:
        storage.write("distortion_coefficients", np.array([distortion]))
    storage.release()
    return path


@pytest.mark.parametrize("kind", ["yml", "yaml", "xml", "json"])
def test_what_opencv_writes_is_read(tmp_path: Path, kind: str) -> None:
    path = opencv_file(tmp_path / f"camera.{kind}", [-0.2, 0, 0, 0, 0], image_width=640)
    camera = read_camera(path, SHAPE)
    np.testing.assert_array_equal(camera.K, K)
    assert camera.kappa == pytest.approx(-0.2, abs=1e-15)


@pytest.mark.parametrize(
    "content",
    [
        ROS,
        json.dumps({"K": K.tolist(), "kappa": -0.2}),
        json.dumps({"cameraMatrix": K.tolist(), "dist_coeffs": [[-0.2, 0, 0, 0]]}),
        json.dumps({"magnification": 4, "camera": {"K": K.tolist(), "kappa": -0.2}}),
    ],
    ids=["ROS", "plain", "camel case", "result.json"],
)
def test_other_spellings_are_read(tmp_path: Path, content: str) -> None:
    path = tmp_path / "camera"
    path.write_text(content)
    camera = read_camera(path, SHAPE)
    np.testing.assert_array_equal(camera.K, K)
    assert camera.kappa == -0.2


def test_without_distortion_kappa_is_left_open(tmp_path: Path) -> None:
    assert read_camera(opencv_file(tmp_path / "camera.yml", None), SHAPE).kappa is None


@pytest.mark.parametrize(
    ("coefficients", "said"),
    [([-0.2, 0.1, 0, 0, 0], "k2 = 0.1"), ([-0.2, 0, 0.001, 0, 0.3], "p1 = 0.001, k3 = 0.3")],
)
def test_more_distortion_than_one_coefficient_is_refused(
    tmp_path: Path, coefficients: list[float], said: str
) -> None:
    path = opencv_file(tmp_path / "camera.yml", coefficients)
    with pytest.raises(InspectionError, match=f"{said}, but the camera model has one radial") as e:
        read_camera(path, SHAPE)
    assert str(e.value).count(str(path)) == 1


def test_a_calibration_of_another_image_size_is_refused(tmp_path: Path) -> None:
    path = opencv_file(tmp_path / "camera.yml", None, image_width=1280, image_height=1024)
    with pytest.raises(InspectionError, match="1280 x 1024 px, but the frames have 640 x 512"):
        read_camera(path, SHAPE)
    with pytest.raises(InspectionError, match="lies outside of the frames of 200 x 100 px"):
        read_camera(opencv_file(tmp_path / "other.yml", None), (100, 200))


@pytest.mark.parametrize(
    ("content", "said"),
    [
        ("", "can't be understood"),
        ("{", "can't be understood"),
        ("[1, 2]", "can't be understood"),
        ("%YAML:1.0\n---\nx: [", "can't be understood"),
        ("<xml", "can't be understood"),
        ("%YAML:1.0\n---\nfocal: 800\n", "holds no camera matrix"),
        ('{"K": [[1, 2], [3]]}', "'k' that is no matrix"),
        ('{"K": [1, 2]}', "has 2 numbers"),
        ('{"K": [[0, 0, 3], [0, 0, 2], [0, 0, 1]]}', "focal lengths in K must be positive"),
    ],
)
def test_a_file_that_is_no_calibration_is_one_sentence(
    tmp_path: Path, content: str, said: str
) -> None:
    path = tmp_path / "camera.yml"
    path.write_text(content)
    with pytest.raises(InspectionError, match=said) as caught:
        read_camera(path, SHAPE)
    assert "\n" not in str(caught.value)
    assert str(path) in str(caught.value)


def test_a_missing_or_binary_file_is_one_sentence(tmp_path: Path) -> None:
    with pytest.raises(InspectionError, match="can't be read"):
        read_camera(tmp_path / "none.yml", SHAPE)
    # The first begins as UTF-16 does, the second does not.
    for content in (b"\xff\xfe\x00", b"\x93NUMPY"):
        (tmp_path / "binary").write_bytes(content)
        with pytest.raises(InspectionError, match="it is no text in UTF-8 or UTF-16"):
            read_camera(tmp_path / "binary", SHAPE)


def nested(opening: str, closing: str, depth: int) -> str:
    return depth * opening + "1" + depth * closing


HEAD = "%YAML:1.0\n---\n"
MATRIX = "K: [[800, 0, 313.5], [0, 802, 260.5], [0, 0, 1]]\n"
BOMB = "".join(
    f'<!ENTITY e{k} "{10 * f"&e{k - 1};"}">' if k else '<!ENTITY e0 "lol">' for k in range(10)
)


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (f"{HEAD}a:{50_000 * '['}", "does not belong there|deep within|can't be understood"),
        (f"{HEAD}a: {50_000 * '['}", "deep within each other"),
        (f"{HEAD}a: {nested('[', ']', 50_000)}", "deep within each other"),
        (f"{HEAD}a: {nested('{b: ', '}', 50_000)}", "deep within each other"),
        (HEAD + "".join(f"{k * ' '}a:\n" for k in range(900)), "deep within each other"),
        (HEAD + "".join(f"{k * ' '}-\n" for k in range(900)), "deep within each other"),
        (HEAD + 300_000 * "a:\n", "lines"),
        (HEAD + 2**20 * " x", "characters"),
        (HEAD + "a: [1, 2\n", "a list in it does not end"),
        (HEAD + "a: [1 , , 2]\n", "stands where a value should"),
        (HEAD + "a: 1\na: 2\n", "'a' twice"),
        (HEAD + "K: [1]\nk: [2]\n", "'k' twice, in two spellings"),
        (MATRIX.replace("800", ".Nan"), "'k' that is no matrix of numbers, but holds 'nan'"),
        (MATRIX.replace("800", "-.Inf"), "but holds '-inf'"),
        (MATRIX.replace("800", "9" * 5000), "but holds"),
        (MATRIX.replace("800", "1e308"), "but holds '1e.308'"),
        (MATRIX.replace("800", "'800'"), "but holds '800'"),
        (MATRIX.replace("800", "1e-9"), "which no lens has"),
        (MATRIX.replace("800", "1e14"), "which no lens has"),
        (f"{MATRIX}kappa: 1e9\n", "moves the edge of the frame by"),
        (f"{MATRIX}kappa: .Nan\n", "'kappa' that is no matrix"),
        (f"{MATRIX}image_width: .Inf\n", "imagewidth is 'inf'"),
        (f"{MATRIX}image_width: [640]\n", "imagewidth is"),
        ("K:\n  rows: 1000000000\n  cols: 3\n  data: [1, 2, 3]\n", "which are not 1000000000 x 3"),
        ("K:\n  rows: 3\n  cols: 3\n  data: [1, 2, 3]\n", "3 numbers, which are not 3 x 3"),
        (200_000 * "<a>", "deep within each other"),
        (f"<!DOCTYPE x [{BOMB}]><opencv_storage>&e9;</opencv_storage>", "declares a document type"),
        ("<opencv_storage><K>1</K><K>2</K></opencv_storage>", "'K' twice"),
        ("<opencv_storage><K>1</opencv_storage>", "it is no XML"),
        ("<other/>", "no <opencv_storage>"),
        ('{"K": ' + 200_000 * "[", "too deep"),
        ('{"K": [[NaN]]}', "NaN, which is no number"),
        ('{"K": [[1e999]]}', "1e999"),
        ('{"K": 1, "K": 2}', "'K' twice"),
        ('{"K": [[800, 0, 300], [0, 800, 200], [0, 0, true]]}', "but holds 'True'"),
        ('{"K": [["800", 0, 300], [0, 800, 200], [0, 0, 1]]}', "but holds '800'"),
    ],
)
def test_a_file_that_was_made_to_do_harm_is_one_sentence(
    tmp_path: Path, content: str, said: str, capfd: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "camera"
    path.write_text(content)
    with pytest.raises(InspectionError, match=said) as caught:
        read_camera(path, SHAPE)
    assert len(str(caught.value)) < 400
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize(
    "content",
    [
        f'{HEAD}# ours\n{MATRIX}kappa: -0.2 # radial\nname: "a # b: ["\n',
        "camera:\n   kappa: -0.2\n   K:\n     - [800, 0, 313.5]\n     - [0, 802., 260.5]\n"
        "     - [0, 0, 1]\n",
        "K:\n- [800, 0, 313.5]\n- [0, 802, 260.5]\n- [0, 0, 1]\nkappa: -0.2\n",
        "%YAML 1.2\n---\ncamera_matrix: { rows: 3, cols: 3, data: [ 8.0e+02, 0., 313.5, 0.,\n"
        "    802, 260.5,\n    0, 0, 1. ] }\ndist_coeffs: [-0.2, 0, 0, 0, 0]\n...\n",
        "<?xml version='1.0'?>\n<opencv_storage><camera><K>800 0 313.5 0 802 260.5 0 0 1</K>"
        "<kappa>-0.2</kappa></camera></opencv_storage>",
    ],
)
def test_the_ways_in_which_people_write_calibrations_are_read(tmp_path: Path, content: str) -> None:
    path = tmp_path / "camera"
    path.write_text(content)
    camera = read_camera(path, SHAPE)
    np.testing.assert_array_equal(camera.K, K)
    assert camera.kappa == -0.2


@settings(max_examples=60, deadline=None)
@given(
    st.dictionaries(
        st.from_regex(r"[a-z][a-z_]{1,9}", fullmatch=True).filter(lambda name: name != "true"),
        st.one_of(
            st.integers(-(10**6), 10**6),
            st.floats(-1e9, 1e9),
            st.text(st.sampled_from("abc XYZ#:[]{},-0"), min_size=1, max_size=12),
            st.lists(st.floats(-1e9, 1e9), min_size=2, max_size=12).map(np.array),
        ),
        min_size=1,
        max_size=6,
    ),
    st.sampled_from([".yml", ".xml"]),
)
def test_whatever_opencv_writes_means_the_same_to_us(entries: dict[str, Any], kind: str) -> None:
    storage = cv2.FileStorage(kind, cv2.FILE_STORAGE_WRITE | cv2.FILE_STORAGE_MEMORY)
    for name, value in entries.items():
        storage.write(name, value)
    text = storage.releaseAndGetString()
    found = yaml_entries(text) if kind == ".yml" else xml_entries(text)
    for name, value in entries.items():
        if isinstance(value, np.ndarray):
            assert found[name]["data"] == pytest.approx(value.tolist(), rel=1e-12)
        elif isinstance(value, str):
            assert str(found[name]).split() == value.split() or kind == ".xml"
        else:
            assert found[name] == pytest.approx(value, rel=1e-12)


@settings(max_examples=300, deadline=None)
@given(st.text(st.sampled_from("ab:-[]{},#'\"!% \n\t<>/01.e"), max_size=60))
def test_no_text_ends_in_anything_but_a_clause(text: str) -> None:
    for read in (yaml_entries, xml_entries):
        with suppress(ValueError):
            assert isinstance(read(text), dict)


@pytest.mark.parametrize(
    "text",
    [
        "a" + 2**19 * " " + "b",
        "a: " + 2**19 * '\\"',
        "a: [" + 2**18 * '\\",',
        "a: [" + 2**17 * "',\" " + "]",
        "a: " + 2**19 * "1" + "x",
        "[" + 2**19 * " ",
        99_000 * "- \n",
        2**19 * "!",
    ],
)
def test_no_long_line_takes_more_than_a_moment(text: str) -> None:
    begun = process_time()
    for read in (yaml_entries, xml_entries):
        with suppress(ValueError):
            read(text)
    # At most 0.4 s here, 1.4 s on a busy machine; what goes back at every letter takes hours.
    assert process_time() - begun < 30.0
