from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest

from pv_inspect.camera_file import read_camera
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
    (tmp_path / "binary").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(InspectionError, match="no text file"):
        read_camera(tmp_path / "binary", SHAPE)
