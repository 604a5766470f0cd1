from __future__ import annotations

import subprocess
import sys
from collections.abc import Generator
from types import SimpleNamespace
from typing import Any

import pytest

from pv_inspect import pipeline
from pv_inspect.inspection.inspection import Inspection, Step
from pv_inspect.progress.notebook_bar import NotebookBar, in_notebook
from pv_inspect.settings import Stage
from tests.handmade import made_inspection


class FakeIPython:
    """What of IPython a kernel offers; remembers what is displayed."""

    def __init__(self, kernel: object | None) -> None:
        self.shell = SimpleNamespace(kernel=kernel)
        self.shown: list[dict[str, str]] = []
        self.display = SimpleNamespace(display=self.first)

    def get_ipython(self) -> object:
        return self.shell

    def first(self, data: dict[str, str], *, raw: bool, display_id: bool) -> FakeIPython:
        assert raw
        assert display_id
        self.shown.append(data)
        return self

    def update(self, data: dict[str, str], *, raw: bool) -> None:
        assert raw
        self.shown[-1] = data


@pytest.fixture
def kernel(monkeypatch: pytest.MonkeyPatch) -> FakeIPython:
    fake = FakeIPython(kernel=object())
    monkeypatch.setitem(sys.modules, "IPython", fake)
    return fake


def steps() -> Generator[Step, None, Inspection]:
    yield Step(Stage.LOAD, 0.0, "3 frames")
    yield Step(Stage.DETECT, 0.5, "found in <3> frames")
    return made_inspection()


def test_a_plain_interpreter_and_a_terminal_of_ipython_are_no_notebook(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.delitem(sys.modules, "IPython", raising=False)
    assert not in_notebook()
    terminal: Any = FakeIPython(kernel=None)
    monkeypatch.setitem(sys.modules, "IPython", terminal)
    assert not in_notebook()


def test_a_script_is_told_nothing(
    monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.delitem(sys.modules, "IPython", raising=False)
    monkeypatch.setattr(pipeline, "inspect_steps", lambda *_: steps())
    assert pipeline.inspect(made_inspection().sequence).complete
    assert capfd.readouterr() == ("", "")


def test_a_notebook_has_one_bar_that_ends_full(
    kernel: FakeIPython, capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(pipeline, "inspect_steps", lambda *_: steps())
    assert pipeline.inspect(made_inspection().sequence).complete
    (data,) = kernel.shown
    assert 'value="1.000" max="1"' in data["text/html"]
    assert data["text/plain"].startswith("100 %  found in <3> frames (")
    assert "found in &lt;3&gt; frames" in data["text/html"]
    assert capfd.readouterr() == ("", "")


def test_a_run_that_fails_leaves_the_bar_where_it_was(
    kernel: FakeIPython, monkeypatch: pytest.MonkeyPatch
) -> None:
    def failing() -> Generator[Step, None, Inspection]:
        yield Step(Stage.LOAD, 0.25, "3 frames")
        raise ValueError("no more")

    monkeypatch.setattr(pipeline, "inspect_steps", lambda *_: failing())
    with pytest.raises(ValueError, match="no more"):
        pipeline.inspect(made_inspection().sequence)
    assert kernel.shown[-1]["text/plain"] == " 25 %  3 frames"


def test_the_bar_is_not_drawn_more_often_than_an_eye_can_follow(
    kernel: FakeIPython, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("pv_inspect.progress.notebook_bar.perf_counter", lambda: 5.0)
    bar = NotebookBar()
    bar.update(0.1, "first")
    bar.update(0.2, "at the same moment")
    assert kernel.shown[-1]["text/plain"].endswith("first")


def test_the_core_loads_neither_matplotlib_nor_ipython_nor_qt() -> None:
    code = (
        "import sys, pv_inspect, pv_inspect.pipeline, pv_inspect.results.write\n"
        "import pv_inspect.notebook.display, pv_inspect.cli.app\n"
        "import pv_inspect.reconstruction.preview\n"
        "heavy = {'matplotlib', 'IPython', 'qtpy', 'PySide6', 'napari', 'ipykernel'}\n"
        "sys.exit(' '.join(heavy & set(sys.modules)) or 0)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


def test_the_package_itself_loads_no_numerical_library() -> None:
    code = "import sys, pv_inspect; sys.exit(' '.join({'numpy', 'cv2'} & set(sys.modules)) or 0)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
