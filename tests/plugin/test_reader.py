from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import dask.array as da
import numpy as np
import pytest
import tifffile
from npe2 import PluginManifest

import napari_pv_inspect
from napari_pv_inspect.layers.layer_data import RESULT_KEY, SEQUENCE_KEY
from napari_pv_inspect.reader import get_reader, read_result, read_sequence
from pv_inspect.image_files.endings import FRAME_ENDINGS, PATTERNS
from pv_inspect.inspection.inspection import Inspection
from pv_inspect.results.write import write_result
from pv_inspect.sequence.sequence import FrameSequence

MANIFEST = Path(napari_pv_inspect.__file__).parent / "napari.yaml"


@pytest.fixture(scope="module")
def result_folder(tiny_inspection: Inspection, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("result") / "out"
    write_result(tiny_inspection, folder)
    return folder


def test_every_command_of_the_manifest_leads_somewhere() -> None:
    manifest = PluginManifest.from_file(MANIFEST)
    manifest.validate_imports()
    contributions = manifest.contributions
    assert contributions.readers
    assert contributions.sample_data
    assert contributions.widgets


def test_package_and_reader_import_nothing_heavy() -> None:
    code = (
        "import sys, napari_pv_inspect, napari_pv_inspect.reader, napari_pv_inspect.sample\n"
        "heavy = {'numpy', 'scipy', 'cv2', 'napari', 'qtpy', 'dask', 'numba', 'pv_inspect'}\n"
        "sys.exit(' '.join(heavy & set(sys.modules)) or 0)"
    )

    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


def test_frames_become_one_lazy_stack_that_carries_the_sequence(tiny_folder: Path) -> None:
    reader = get_reader(str(tiny_folder))
    assert reader is read_sequence
    ((data, attributes, kind),) = reader(str(tiny_folder))
    assert isinstance(data, da.Array)
    assert data.shape == (5, 180, 240)
    assert kind == "image"
    sequence = attributes["metadata"][SEQUENCE_KEY]
    assert isinstance(sequence, FrameSequence)
    np.testing.assert_array_equal(data[3].compute(), sequence.frame(3).image)


def test_a_multi_page_tiff_and_a_list_of_frames_are_sequences(
    tiny_folder: Path, tiny_sequence: FrameSequence, tmp_path: Path
) -> None:
    stack = tmp_path / "stack.tif"
    tifffile.imwrite(
        stack, np.stack([tiny_sequence.raw(i) for i in range(3)]), photometric="minisblack"
    )
    files = [str(p) for p in sorted((tiny_folder / "frames").iterdir())]
    for path, count in ((str(stack), 3), (files, 5)):
        reader = get_reader(path)
        assert reader is not None
        assert reader(path)[0][0].shape[0] == count


def test_a_result_folder_becomes_module_image_support_and_cracks(
    result_folder: Path, tiny_inspection: Inspection
) -> None:
    reader = get_reader(str(result_folder))
    assert reader is read_result
    layers = reader(str(result_folder))
    assert [attributes["name"] for _, attributes, _ in layers] == [
        "Module image",
        "Support",
        "Contradictions",
        "Cracks",
    ]
    assert tiny_inspection.reconstruction is not None
    np.testing.assert_array_equal(layers[0][0], tiny_inspection.reconstruction.image)
    assert RESULT_KEY in layers[0][1]["metadata"]


def test_the_workbench_opens_what_the_command_line_opens(tmp_path: Path) -> None:
    manifest = PluginManifest.from_file(MANIFEST)
    (reader,) = manifest.contributions.readers or []
    assert sorted(reader.filename_patterns) == sorted(PATTERNS.split())
    for ending in FRAME_ENDINGS:
        path = tmp_path / f"x{ending.upper()}"
        path.write_bytes(b"")
        assert get_reader(str(path)) is read_sequence
        assert get_reader([str(path)]) is read_sequence


def test_other_paths_are_left_to_other_readers(tmp_path: Path) -> None:
    (tmp_path / "notes.txt").write_text("x")
    assert get_reader(str(tmp_path)) is None
    assert get_reader(str(tmp_path / "notes.txt")) is None
    assert get_reader([]) is None
    assert get_reader(str(tmp_path / "nowhere")) is None


def test_a_folder_that_can_not_be_read_is_one_sentence(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(_: Path) -> None:
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(Path, "iterdir", refuse)
    sentences: list[str] = []
    monkeypatch.setattr("napari.utils.notifications.show_error", sentences.append)
    read = get_reader(str(tmp_path))
    assert read is not None
    assert read(str(tmp_path)) == [(None,)]
    assert len(sentences) == 1
    assert "permissions" in sentences[0]


@pytest.mark.parametrize("question", ["is_dir", "is_file", "iterdir"])
def test_a_folder_that_may_not_be_looked_into_is_ours_to_explain(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, question: str
) -> None:
    def refuse(_: Path) -> None:
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(Path, question, refuse)
    assert get_reader(str(tmp_path)) is read_sequence


def test_a_broken_sequence_is_one_sentence_and_no_layer(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "frame_0.tif").write_bytes(b"this is no TIFF")
    sentences: list[str] = []
    monkeypatch.setattr("napari.utils.notifications.show_error", sentences.append)
    assert read_sequence(str(tmp_path)) == [(None,)]
    assert len(sentences) == 1
    assert "frame_0.tif" in sentences[0]
