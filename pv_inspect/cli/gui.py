"""The command ``pv-inspect gui``: the workbench, where there is one and a display for it."""

from __future__ import annotations

import os
import subprocess
import sys
from importlib import import_module
from pathlib import Path
from typing import Annotated

import typer

from pv_inspect.common import signals
from pv_inspect.errors import InspectionError

__all__ = ["Shown", "open_workbench"]

Shown = Annotated[
    Path | None,
    typer.Argument(
        help="Frames or a result folder to open.", metavar="SEQUENCE", show_default=False
    ),
]

# Seconds until a display is taken for dead.
_DISPLAY_S = 30.0


def open_workbench(sequence: Path | None) -> None:
    """Open the workbench and return when its window is closed.

    Parameters
    ----------
    sequence : Path or None
        Frames or a result folder to open in it.

    Raises
    ------
    InspectionError
        If the path does not exist, napari is not installed or no display answers.
    """
    if sequence is not None and not sequence.exists():
        raise InspectionError(f"{sequence} does not exist: give a folder of frames or a TIFF.")
    try:
        import_module("napari")
        launch = import_module("napari_pv_inspect").launch
    except ImportError as error:
        raise InspectionError(
            f"The workbench needs napari and Qt, but {error.name or error} can't be loaded: "
            'install them with  pip install "pv-inspect[gui]".'
        ) from None
    _need_a_display()
    signals.usual()  # Qt does not let a signal's exception out
    launch(sequence)


def _need_a_display() -> None:
    """Look for one from outside: Qt aborts its own process where it finds none."""
    if sys.platform != "linux":
        return
    wanted = ("DISPLAY", "WAYLAND_DISPLAY", "QT_QPA_PLATFORM")
    if not any(os.environ.get(name) for name in wanted):
        raise InspectionError(
            "The workbench needs a display and there is none: log in at a desktop, or "
            "through ssh -X; `pv-inspect run` works without."
        )
    probe = "from qtpy.QtGui import QGuiApplication; QGuiApplication([])"
    said = ""
    try:
        asked = subprocess.run(
            [sys.executable, "-c", probe], capture_output=True, text=True, timeout=_DISPLAY_S
        )
    except subprocess.TimeoutExpired:
        said = f"the display has not answered for {_DISPLAY_S:.0f} s"
    else:
        if asked.returncode != 0:
            lines = (line for line in asked.stderr.splitlines() if "qt.qpa" in line)
            said = next(lines, "no reason is known")
    if said:
        raise InspectionError(
            f"The workbench can't open a window ({said}): check DISPLAY and that Qt's system "
            "libraries are installed; `pv-inspect run` works without."
        )
