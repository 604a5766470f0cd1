"""The notebooks in examples/, executed in a kernel of their own."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import nbformat
from nbclient import NotebookClient

EXAMPLES = Path(__file__).resolve().parents[1] / "examples"


def executed(name: str, folder: Path = EXAMPLES) -> list[Any]:
    """Outputs of all cells in their order; fails where a cell fails.

    Parameters
    ----------
    name : str
    folder : Path
        Where it runs: beside it lies ``sample_data/module``.
    """
    notebook = nbformat.read(EXAMPLES / name, 4)
    where = {"metadata": {"path": str(folder)}}
    NotebookClient(notebook, timeout=300, kernel_name="python3", resources=where).execute()
    return [output for cell in notebook.cells for output in cell.get("outputs", [])]


def shown(outputs: list[Any], kind: str) -> list[str]:
    """What of one MIME type was displayed."""
    return [output.data[kind] for output in outputs if kind in output.get("data", {})]
