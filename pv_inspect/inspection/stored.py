"""The result folder that an inspection was read from."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

__all__ = ["StoredResult"]


@dataclass(frozen=True, eq=False)
class StoredResult:
    """A result folder, and what its ``result.json`` says.

    Parameters
    ----------
    folder : Path
    record : dict
        All of ``result.json``, with the defaults of what an earlier version did not say.
    """

    folder: Path
    record: dict[str, Any] = field(repr=False)

    @property
    def names(self) -> tuple[str, ...]:
        """File names of the frames."""
        return tuple(frame["file"] for frame in self.record["frames"])

    @property
    def versions(self) -> dict[str, str]:
        """Versions of the program and of its libraries that made the result."""
        found: dict[str, str] = self.record["versions"]
        return found
