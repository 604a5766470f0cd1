"""What a person looked at in a result folder, so that the next session goes on from there."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated

from pydantic import Field

from pv_inspect.common.records import (
    Pair,
    Place,
    StoredRecord,
    Text,
    Whole,
    checked,
    json_from,
    read_text,
)
from pv_inspect.errors import InspectionError
from pv_inspect.storage.folders import replace_file
from pv_inspect.storage.reservations import changing

__all__ = ["Session", "read_session", "write_session"]

SESSION_JSON = "session.json"
_MOST_BYTES = 2**16


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
    """Write ``session.json``, whole or not at all; of two windows the last one's view is kept.

    Returns
    -------
    bool
        False if the folder can't be written to; nobody loses work by that.
    """
    try:
        with changing(folder):
            replace_file(folder / SESSION_JSON, _content(session))
    except InspectionError:
        return False
    return True


def read_session(folder: Path) -> Session:
    """Read ``session.json``; the default where there is none.

    Raises
    ------
    InspectionError
        If it is damaged. Nothing but the view is lost.
    """
    path = folder / SESSION_JSON
    try:
        found = checked(_SessionRecord, json_from(read_text(path, _MOST_BYTES)))
    except FileNotFoundError:
        return Session()
    except (OSError, ValueError) as error:
        raise InspectionError(
            f"{path} can't be read ({error}): the module is shown as if it was opened for the "
            "first time."
        ) from None
    return Session(found.cell, found.frame, found.page, found.centre, found.zoom or None)


def _content(session: Session) -> bytes:
    record = {"format": _SessionRecord.newest_format, **asdict(session)}
    return json.dumps(record, indent=1).encode()


class _SessionRecord(StoredRecord):
    cell: tuple[Place, Place] | None
    frame: Whole
    page: Text
    centre: Pair | None
    zoom: Annotated[float, Field(strict=True, ge=0, le=1e6)] | None
