from __future__ import annotations

import errno
import json
import re
import sys
from collections.abc import Generator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np
import pytest
import tifffile
from typer.testing import CliRunner, Result

import pv_inspect
from pv_inspect import pipeline
from pv_inspect.cli import app as cli
from pv_inspect.cli import gui as cli_gui
from pv_inspect.cli.run import IN_DOUBT
from pv_inspect.inspection.inspection import Step
from pv_inspect.results.read import read_result
from pv_inspect.settings import Settings, Stage
from pv_inspect.simulate import SimulationSettings, reserve_sequence
from pv_inspect.storage import folders
from tests.handmade import made_inspection


def called(*arguments: object) -> Result:
    return CliRunner().invoke(cli.app, [str(a) for a in arguments])


def refused(result: Result, said: str, code: int = 1) -> None:
    """One sentence on stderr, nothing on stdout, no traceback."""
    assert result.exit_code == code, result.output
    lines = [line for line in result.stderr.splitlines() if not re.match(r"\s*\d+ %  ", line)]
    assert len(lines) == 1, result.stderr
    assert lines[0].startswith("pv-inspect: ")
    assert re.search(said, lines[0]), lines[0]
    assert result.stdout == ""


@pytest.fixture
def frames(tmp_path: Path) -> Path:
    """Three frames that show nothing, and how many cells there should be."""
    folder = tmp_path / "frames"
    folder.mkdir()
    rng = np.random.default_rng(0)
    for i in range(3):
        noise = rng.normal(800, 20, (96, 128)).astype(np.uint16)
        tifffile.imwrite(folder / f"frame_{i}.tif", noise)
    (folder / "module.json").write_text(json.dumps({"rows": 2, "cols": 3}))
    return folder


@pytest.fixture
def quick(monkeypatch: pytest.MonkeyPatch) -> list[Settings]:
    """A pipeline that ends at once; returns the settings that it was called with."""
    seen: list[Settings] = []

    def inspect_steps(_: Any, settings: Settings) -> Generator[Step, None, Any]:
        seen.append(settings)
        yield Step(Stage.DETECT, 0.5, "looking")
        return made_inspection(warnings=("a warning.",))

    monkeypatch.setattr(pipeline, "inspect_steps", inspect_steps)
    return seen


def test_a_run_writes_the_result_and_sums_it_up_on_stdout(
    frames: Path, tmp_path: Path, quick: list[Settings]
) -> None:
    result = called("run", frames, "--out", tmp_path / "out")
    assert result.exit_code == 0, result.output
    assert (tmp_path / "out" / "result.json").exists()
    for said in (
        "2 of 3 used",
        "not used: frame_1",
        "residual  1.10",
        "suspected in 1",
        "a warning.",
    ):
        assert said in result.stdout
    assert str(tmp_path / "out" / "report.html") in result.stdout


@pytest.mark.parametrize("quiet", [False, True])
def test_a_result_in_doubt_says_so_first_and_exits_with_3(
    frames: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, quiet: bool
) -> None:
    def inspect_steps(*_: Any) -> Generator[Step, None, Any]:
        yield Step(Stage.DETECT, 0.5, "looking")
        return made_inspection(doubts=("The frames contradict each other.",))

    monkeypatch.setattr(pipeline, "inspect_steps", inspect_steps)
    options = ["--quiet"] if quiet else []
    result = called("run", frames, "--out", tmp_path / "out", *options)
    assert result.exit_code == IN_DOUBT == 3
    said = result.stderr if quiet else result.stdout
    assert "The frames contradict each other." in said.splitlines()[0]
    assert read_result(tmp_path / "out").doubts == ("The frames contradict each other.",)
    page = (tmp_path / "out" / "report.html").read_text()
    assert page.index("The frames contradict each other.") < page.index('class="lead"')


def test_quiet_prints_nothing(frames: Path, tmp_path: Path, quick: list[Settings]) -> None:
    result = called("run", frames, "--out", tmp_path / "out", "--quiet")
    assert (result.exit_code, result.output) == (0, "")


def test_options_win_over_the_settings_file(
    frames: Path, tmp_path: Path, quick: list[Settings]
) -> None:
    toml = tmp_path / "mine.toml"
    toml.write_text("magnification = 3.0\nprior_weight = 0.2\n")
    options = ("--settings", toml, "--lambda", 0.3, "--psf-sigma", 0.5, "--focal-length", 900)
    assert called("run", frames, "-o", tmp_path / "out", *options).exit_code == 0
    expected = {"magnification": 3.0, "prior_weight": 0.3, "psf_sigma_lr_px": 0.5}
    assert quick == [Settings.create(**expected, focal_length_px=900)]


def test_every_setting_has_an_option_with_its_unit() -> None:
    text = " ".join(called("run", "--help").stdout.split())
    for name in Settings.model_fields:
        described = Settings.model_fields[name].description or ""
        assert described.split(";")[0].split(":")[0][:30] in text
    assert "[0.1 to 3 LR px]" in text
    assert "default 200]" in text


def test_version_and_help_answer() -> None:
    assert called("--version").stdout == f"pv-inspect {pv_inspect.__version__}\n"
    for command in ("run", "simulate", "gui"):
        assert called(command, "--help").exit_code == 0


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("run",), "SEQUENCE.*see pv-inspect run --help"),
        (("run", "x"), "--out.*see pv-inspect run --help"),
        (("run", "x", "--out", "y", "--rows", "six"), "--rows.*integer"),
        (("run", "x", "--out", "y", "--nothing", 1), "--nothing"),
        (("walk",), "walk.*see pv-inspect --help"),
        (("--nothing",), "--nothing"),
    ],
)
def test_wrong_usage_is_one_sentence_and_exits_with_2(
    arguments: tuple[object, ...], said: str
) -> None:
    refused(called(*arguments), said, code=2)


def test_without_arguments_the_help_is_shown() -> None:
    assert "Commands:" in called().output


def test_an_empty_folder_is_one_sentence(tmp_path: Path) -> None:
    (tmp_path / "empty").mkdir()
    refused(called("run", tmp_path / "empty", "--out", tmp_path / "out"), "empty")
    assert not (tmp_path / "out").exists()


def test_an_unreadable_frame_is_one_sentence(frames: Path, tmp_path: Path) -> None:
    (frames / "frame_1.tif").write_bytes(b"no picture")
    refused(called("run", frames, "--out", tmp_path / "out"), r"frame_1\.tif")


def test_mixed_sizes_are_one_sentence(frames: Path, tmp_path: Path) -> None:
    tifffile.imwrite(frames / "frame_2.tif", np.zeros((90, 128), np.uint16))
    refused(called("run", frames, "--out", tmp_path / "out"), r"frame_2\.tif.*128 x 90")


def test_frames_without_a_module_are_one_sentence(frames: Path, tmp_path: Path) -> None:
    refused(called("run", frames, "--out", tmp_path / "out"), "2 rows x 3 columns|2 x 3 cells")
    assert not (tmp_path / "out").exists()


def test_rows_and_columns_that_cannot_be_guessed_are_refused(frames: Path, tmp_path: Path) -> None:
    (frames / "module.json").unlink()
    refused(called("run", frames, "--out", tmp_path / "out"), "can't be guessed.*--rows")


@pytest.mark.parametrize(
    ("option", "value"), [("--magnification", 9), ("--rows", 0), ("--lambda", "nan")]
)
def test_a_value_outside_its_range_is_one_sentence(
    frames: Path, tmp_path: Path, option: str, value: object
) -> None:
    refused(called("run", frames, "--out", tmp_path / "out", option, value), "Setting")


def test_an_unwritable_out_is_refused_before_anything_is_computed(
    frames: Path, tmp_path: Path, quick: list[Settings]
) -> None:
    (tmp_path / "file").write_text("mine")
    refused(called("run", frames, "--out", tmp_path / "file" / "out"), "is a file, so that")
    refused(called("run", frames, "--out", frames), "not empty")
    assert quick == []


def test_a_full_disk_is_one_sentence_and_leaves_nothing(
    frames: Path, tmp_path: Path, quick: list[Settings], monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(path: Path, content: bytes) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(folders, "_write_file", full)
    refused(called("run", frames, "--out", tmp_path / "out"), "the disk is full")
    assert [p.name for p in tmp_path.iterdir()] == ["frames"]


def failing(error: BaseException) -> Any:
    def inspect_steps(*_: Any) -> Generator[Step, None, Any]:
        yield Step(Stage.DETECT, 0.0, "looking")
        raise error

    return inspect_steps


def test_a_calibration_file_is_checked_before_anything_is_computed(
    frames: Path, tmp_path: Path, quick: list[Settings]
) -> None:
    arguments = ("run", frames, "--out", tmp_path / "out", "--calibration")
    refused(called(*arguments, tmp_path / "none.yml"), r"none\.yml can't be read")
    assert quick == []
    (tmp_path / "camera.json").write_text('{"K": [[90, 0, 63], [0, 90, 47], [0, 0, 1]]}')
    assert called(*arguments, tmp_path / "camera.json").exit_code == 0
    assert quick[0].calibration_file == tmp_path / "camera.json"


def test_an_interrupt_exits_with_130_and_one_line(
    frames: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(pipeline, "inspect_steps", failing(KeyboardInterrupt()))
    refused(called("run", frames, "--out", tmp_path / "out"), "Interrupted", code=130)
    assert not (tmp_path / "out").exists()


def test_a_fault_of_the_program_is_one_sentence_and_debug_shows_where(
    frames: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(pipeline, "inspect_steps", failing(ZeroDivisionError("a\nb")))
    arguments = ("run", frames, "--out", tmp_path / "out")
    refused(called(*arguments), r"ZeroDivisionError: a b \(--debug shows where\)")
    assert "Traceback" in called(*arguments, "--debug").stderr


def test_simulate_writes_frames_and_truth(tmp_path: Path) -> None:
    size = ("--frames", 2, "--width", 96, "--height", 80, "--rows", 2, "--cols", 3)
    small = ("--set", "pixels_per_unit=40", "--set", "supersampling=2", "--set", "shot_noise=false")
    result = called("simulate", tmp_path / "sim", *size, *small)
    assert result.exit_code == 0, result.output
    assert len(list((tmp_path / "sim" / "frames").iterdir())) == 2
    truth = json.loads((tmp_path / "sim" / "truth" / "truth.json").read_text())
    assert truth["noise"]["shot_noise"] is False
    image = cv2.imread(str(tmp_path / "sim" / "frames" / "frame_000.tif"), cv2.IMREAD_UNCHANGED)
    assert image.shape == (80, 96)


def test_a_simulation_into_a_folder_that_is_taken_is_refused_before_it_begins(
    tmp_path: Path,
) -> None:
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "mine.txt").write_text("mine")
    refused(called("simulate", tmp_path / "full"), "is not an empty folder")
    with reserve_sequence(tmp_path / "sim"):
        refused(called("simulate", tmp_path / "sim"), "Another pv-inspect .* is writing to")
    assert [path.name for path in tmp_path.iterdir()] == ["full"]


def test_simulate_lists_all_its_numbers(tmp_path: Path) -> None:
    text = called("simulate", tmp_path / "x", "--set", "help").stdout
    for name in SimulationSettings.__dataclass_fields__:
        assert f"{name} = " in text


@pytest.mark.parametrize("text", ["nothing=1", "kappa", "n_frames=many"])
def test_a_wrong_number_of_the_simulation_is_one_sentence(tmp_path: Path, text: str) -> None:
    refused(called("simulate", tmp_path / "sim", "--set", text), f"--set {text}")


def test_gui_without_napari_says_how_to_get_it(monkeypatch: pytest.MonkeyPatch) -> None:
    def missing(name: str) -> Any:
        raise ModuleNotFoundError(f"No module named {name!r}", name=name)

    monkeypatch.setattr(cli_gui, "import_module", missing)
    refused(called("gui"), r'napari can\'t be loaded: install them with +pip install "pv-inspect')


@pytest.mark.skipif(sys.platform != "linux", reason="elsewhere there is always a display")
def test_gui_without_a_display_is_one_sentence(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cli_gui, "import_module", lambda _: SimpleNamespace(launch=pytest.fail))
    for name in ("DISPLAY", "WAYLAND_DISPLAY", "QT_QPA_PLATFORM"):
        monkeypatch.delenv(name, raising=False)
    refused(called("gui"), "needs a display")


@pytest.mark.skipif(sys.platform != "linux", reason="elsewhere there is always a display")
def test_gui_on_a_display_that_does_not_answer_is_one_sentence(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    pytest.importorskip("qtpy")
    monkeypatch.setattr(cli_gui, "import_module", lambda _: SimpleNamespace(launch=pytest.fail))
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    monkeypatch.setenv("QT_QPA_PLATFORM", "xcb")
    monkeypatch.setenv("DISPLAY", ":98765")
    refused(called("gui"), r"can\'t open a window \(qt.qpa")
    monkeypatch.setattr(cli_gui, "_DISPLAY_S", 0.0)
    refused(called("gui"), r"the display has not answered for 0 s")


def test_gui_with_a_missing_sequence_is_one_sentence(tmp_path: Path) -> None:
    refused(called("gui", tmp_path / "no"), "does not exist")


def test_every_setting_has_one_option_with_its_unit_and_range() -> None:
    import re

    said = " ".join(called("run", "--help").stdout.split())
    for name in Settings.model_fields:
        (long,) = (n.split("/")[0] for n in Settings.options_of(name) if n.startswith("--"))
        assert len(re.findall(rf"(?<!\w){long} ", said)) == 1, name
    assert "0 to 1000 noise units" in said
    assert "[0.1 to 3 LR px]" in said
