"""Drive the real application on the sample and save what it shows as docs/workbench.png.

xvfb-run -a -s "-screen 0 1600x1000x24" env QT_QPA_PLATFORM=xcb LIBGL_ALWAYS_SOFTWARE=1 \
        python docs/make_screenshot.py
"""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path

import napari
from qtpy.QtWidgets import QApplication

from napari_pv_inspect.application import build
from napari_pv_inspect.models.workbench import RunState
from napari_pv_inspect.sample import sample_folder

SIZE = (1600, 960)


def process_events(seconds: float) -> None:
    """Let the window work for a while."""
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        QApplication.processEvents()
        time.sleep(0.01)


def main(arguments: list[str]) -> None:
    """Open, run, save the picture."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--sequence", type=Path, help="folder of frames; the sample if not given")
    parser.add_argument("--out", type=Path, default=Path(__file__).parent / "workbench.png")
    options = parser.parse_args(arguments)
    viewer = napari.Viewer(title="pv-inspect", show=True)
    window = viewer.window._qt_window
    window.resize(*SIZE)
    dock, _cells = build(viewer)
    process_events(1.0)
    dock.workbench.open(options.sequence or sample_folder())
    while dock.workbench.opener.busy:
        process_events(0.2)
    process_events(1.0)
    dock.run.run.click()
    while dock.workbench.model.run_state is not RunState.IDLE:
        process_events(0.2)
    process_events(1.0)
    dock.workbench.navigator.to_all()
    process_events(1.0)
    if not window.screen().grabWindow(window.winId()).save(str(options.out)):
        sys.exit(f"{options.out} can't be written.")
    viewer.close()


if __name__ == "__main__":
    main(sys.argv[1:])
