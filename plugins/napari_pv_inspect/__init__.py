"""The napari workbench of pv-inspect: it shows, asks and remembers; the core computes.

``model`` holds the state and knows neither Qt nor napari, ``docks`` and ``layers`` show it,
``worker`` runs the pipeline beside the window, ``workbench`` ties them to one viewer.
Nothing heavy is imported here: napari reads this package when it starts.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from pathlib import Path

__all__ = ["launch"]


def launch(path: Path | None = None) -> None:
    """Open the workbench, load a sequence or a result folder into it, and run until it is closed.

    Parameters
    ----------
    path : Path, optional
        Folder of frames, multi-page TIFF, or result folder.
    """
    from napari_pv_inspect.application import run

    run(path)
