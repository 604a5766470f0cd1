"""A progress bar in the output of a notebook's cell.

IPython is looked for, never imported: where a notebook runs, it is loaded.
"""

from __future__ import annotations

import sys
from html import escape
from time import perf_counter
from typing import Any

__all__ = ["NotebookBar", "in_notebook"]

_SECONDS_BETWEEN = 0.1


def in_notebook() -> bool:
    """Whether the code runs in a kernel of Jupyter."""
    ipython = sys.modules.get("IPython")
    shell = ipython.get_ipython() if ipython is not None else None
    return getattr(shell, "kernel", None) is not None


class NotebookBar:
    """A bar with a message; it stays in the notebook as it was shown last."""

    def __init__(self) -> None:
        self._begun = perf_counter()
        self._shown = -_SECONDS_BETWEEN
        self._handle: Any = None

    def update(self, fraction: float, message: str) -> None:
        """Show how far the work is, as often as an eye can follow.

        Parameters
        ----------
        fraction : float
            Share of the work that is done, 0 to 1.
        message : str
            What is being done.
        """
        if perf_counter() - self._shown >= _SECONDS_BETWEEN:
            self._show(fraction, message)
            self._shown = perf_counter()

    def end(self, message: str) -> None:
        """Show that the work is done, and how long it took."""
        self._show(1.0, f"{message} ({perf_counter() - self._begun:.1f} s)")

    def _show(self, fraction: float, message: str) -> None:
        text = f"{100 * fraction:3.0f} %  {message}"
        bar = f'<progress value="{fraction:.3f}" max="1" style="width: 16em"></progress>'
        # Kernels also serve consoles, which show the text.
        both = {"text/html": f"<div>{bar} {escape(text)}</div>", "text/plain": text}
        if self._handle is None:
            self._handle = sys.modules["IPython"].display.display(both, raw=True, display_id=True)
        else:
            self._handle.update(both, raw=True)
