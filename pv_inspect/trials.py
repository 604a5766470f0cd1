"""``trials.npz``: the settings that were tried on a module, with a picture of a cell each.

They lie in the result folder beside ``session.json``, so that the next session goes on from there.
"""

from __future__ import annotations

import io
import json
import zipfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pv_inspect.errors import InspectionError
from pv_inspect.folders import replace_file
from pv_inspect.records import Place, Record, Text, Whole, checked, json_from
from pv_inspect.settings import Settings

__all__ = ["KeptTrial", "read_trials", "worth_keeping", "write_trials"]

TRIALS_NPZ = "trials.npz"
# So many are kept, and so many bytes of pictures.
MOST, MOST_BYTES = 60, 2**23


@dataclass(frozen=True, eq=False)
class KeptTrial:
    """A setting that was tried.

    Parameters
    ----------
    number : int
        From 1; tells trials apart.
    settings : Settings
    image : (height, width) float32
        The cell as it looked then, full scale = 1; kept to three digits.
    cell : (row, col)
    caption, text, name : str
        What was used, what differs from the trial before, and the user's name for it, or "".
    """

    number: int
    settings: Settings
    image: NDArray[np.float32]
    cell: tuple[int, int]
    caption: str
    text: str
    name: str = ""


def worth_keeping(trials: Sequence[KeptTrial]) -> list[KeptTrial]:
    """Choose what there is room for: those with a name first, then the newest; order is kept."""
    chosen: set[int] = set()
    room = MOST_BYTES
    for trial in sorted(trials, key=lambda trial: (not trial.name, -trial.number)):
        size = 2 * trial.image.size
        if len(chosen) < MOST and size <= room:
            chosen.add(trial.number)
            room -= size
    return [trial for trial in trials if trial.number in chosen]


def write_trials(trials: Sequence[KeptTrial], folder: Path) -> None:
    """Write what is `worth_keeping` of some trials, whole or not at all.

    Raises
    ------
    InspectionError
        If it can't be written; then an earlier file is as it was.
    """
    if not folder.is_dir():
        raise InspectionError(
            f"The trials can't be written to {folder}: the folder is gone; save the result again."
        )
    kept = worth_keeping(trials)
    about = [
        {
            "number": trial.number,
            "settings": trial.settings.model_dump(mode="json", exclude_none=True),
            "cell": trial.cell,
            "caption": trial.caption,
            "text": trial.text,
            "name": trial.name,
        }
        for trial in kept
    ]
    pictures = {f"picture_{k}": trial.image.astype(np.float16) for k, trial in enumerate(kept)}
    content = io.BytesIO()
    np.savez(content, about=np.array(json.dumps(about)), **pictures)  # type: ignore[arg-type]
    replace_file(folder / TRIALS_NPZ, content.getvalue())


def read_trials(folder: Path) -> tuple[KeptTrial, ...]:
    """Read the trials of a result folder; none if there is no file.

    Raises
    ------
    InspectionError
        If the file is damaged, or was not written by this version.
    """
    path = folder / TRIALS_NPZ
    try:
        # Somebody else's file must not fill the memory.
        if path.exists() and not path.is_file():
            raise ValueError("it is no file")
        if path.stat().st_size > 2 * MOST_BYTES:
            raise ValueError("too large")
        with zipfile.ZipFile(path) as file:
            if sum(entry.file_size for entry in file.infolist()) > 2 * MOST_BYTES:
                raise ValueError("too large")
        with np.load(path, allow_pickle=False) as file:
            about = json_from(str(file["about"]))
            if not isinstance(about, list):
                raise TypeError("its list of trials is none")
            found = tuple(
                _trial(checked(_TrialRecord, record), file[f"picture_{k}"])
                for k, record in enumerate(about[:MOST])
            )
            if len({trial.number for trial in found}) < len(found):
                raise ValueError("two trials have the same number")
            return found
    except FileNotFoundError:
        return ()
    except Exception as error:  # a file from elsewhere can be wrong in any way, and is only a list
        raise InspectionError(
            f"The trials kept in {path} can't be read ({error}): they are left out, and a new list "
            "begins."
        ) from None


class _TrialRecord(Record):
    number: Whole
    settings: dict[str, Any]
    cell: tuple[Place, Place]
    caption: Text
    text: Text
    name: Text


def _trial(record: _TrialRecord, picture: NDArray[np.generic]) -> KeptTrial:
    if picture.ndim != 2 or picture.dtype != np.float16 or min(picture.shape) < 1:
        raise ValueError("a picture is none")
    return KeptTrial(
        record.number,
        Settings.create(**record.settings),
        np.nan_to_num(picture.astype(np.float32)),
        record.cell,
        record.caption,
        record.text,
        record.name,
    )
