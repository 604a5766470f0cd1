"""The napari workbench of pv-inspect: a view of what the core computes, and controls for it.

``models`` and ``review`` hold the state, ``docks`` and ``layers`` show it, ``tasks`` runs the
pipeline in the background, ``workbench`` connects all of them for one viewer.
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
        Folder of frames, file that holds several, or result folder.
    """
    from napari_pv_inspect.application import run

    run(path)
