"""What a person looked at in a result folder, so that the next session goes on from there."""

from __future__ import annotations

import json
import os
from contextlib import suppress
from dataclasses import asdict, dataclass
from pathlib import Path

__all__ = ["Session", "read_session", "write_session"]

SESSION_JSON = "session.json"


@dataclass(frozen=True)
class Session:
    """State of the view of one result.

    Parameters
    ----------
    cell : (row, col) or None
        The selected cell, from 0.
    frame : int
        The frame under the time slider.
    page : str
        The open page of the controls; "" if none is known.
    centre : (row, col) or None
        Middle of the canvas, LR pixels of the world.
    zoom : float or None
        Screen pixels per LR pixel.
    """

    cell: tuple[int, int] | None = None
    frame: int = 0
    page: str = ""
    centre: tuple[float, float] | None = None
    zoom: float | None = None


def write_session(session: Session, folder: Path) -> bool:
    """Write ``session.json``, whole or not at all.

    Returns
    -------
    bool
        False if the folder can't be written to; nobody loses work by that.
    """
    path = folder / SESSION_JSON
    beside = path.with_name(f".{SESSION_JSON}.{os.getpid()}")
    try:
        beside.write_text(json.dumps(asdict(session), indent=1), encoding="utf-8")
        beside.replace(path)
    except OSError:
        with suppress(OSError):
            beside.unlink()
        return False
    return True


def read_session(folder: Path) -> Session:
    """Read ``session.json``; the default where there is none or it is damaged."""
    try:
        record = json.loads((folder / SESSION_JSON).read_text(encoding="utf-8"))
        cell, centre, zoom = record["cell"], record["centre"], record["zoom"]
        return Session(
            None if cell is None else (int(cell[0]), int(cell[1])),
            max(0, int(record["frame"])),
            str(record["page"]),
            None if centre is None else (float(centre[0]), float(centre[1])),
            float(zoom) if zoom else None,
        )
    except (OSError, ValueError, KeyError, TypeError, IndexError):
        return Session()
