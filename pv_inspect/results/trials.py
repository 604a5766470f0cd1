"""``trials.npz``: the settings that were tried on a module, with a picture of a cell each.

They lie in the result folder beside ``session.json``, so that the next session goes on from there.
"""

from __future__ import annotations

import io
import json
import sys
import zipfile
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from pv_inspect.common.records import Place, StoredRecord, Text, Whole, checked, json_from
from pv_inspect.errors import InspectionError
from pv_inspect.results.records import settings_of
from pv_inspect.settings import Settings
from pv_inspect.storage.folders import replace_file
from pv_inspect.storage.reservations import changing

__all__ = ["KeptTrial", "merged", "read_trials", "worth_keeping", "write_trials"]

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
    frames : str
        Where the frames lie that it was tried on; "" if that is not known.
    """

    number: int
    settings: Settings
    image: NDArray[np.float32]
    cell: tuple[int, int]
    caption: str
    text: str
    name: str = ""
    frames: str = ""


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


def merged(
    ours: Sequence[KeptTrial], base: Sequence[KeptTrial], theirs: Sequence[KeptTrial]
) -> list[KeptTrial]:
    """Bring together the trials of two windows; settings tell trials apart.

    Parameters
    ----------
    ours : sequence of KeptTrial
        They keep their numbers; of a trial that both have, ours counts if we changed it.
    base : sequence of KeptTrial
        What was in the file when we read or wrote it last; what is missing of it in ``ours`` was
        removed by us.
    theirs : sequence of KeptTrial
        What is in the file now.

    Returns
    -------
    list of KeptTrial
        By number; each number is given once.
    """
    before = {_key(trial): trial for trial in base}
    there = {_key(trial): trial for trial in theirs}
    found = []
    for trial in ours:
        key = _key(trial)
        ours_changed = key not in before or before[key].name != trial.name
        name = trial.name if ours_changed or key not in there else there[key].name
        found.append(replace(trial, name=name))
    known = {_key(trial) for trial in ours} | set(before)
    taken = {trial.number for trial in found}
    for trial in theirs:
        if _key(trial) not in known:
            number = trial.number if trial.number not in taken else max(taken) + 1
            taken.add(number)
            found.append(replace(trial, number=number))
    return sorted(found, key=lambda trial: trial.number)


def _key(trial: KeptTrial) -> str:
    return json.dumps(trial.settings.model_dump(mode="json"), sort_keys=True)


def write_trials(
    trials: Sequence[KeptTrial], folder: Path, base: Sequence[KeptTrial] | None = None
) -> int:
    """Write what is `worth_keeping` of some trials, whole or not at all.

    What another window has put into the file since is kept, see `merged`.

    Parameters
    ----------
    trials : sequence of KeptTrial
    folder : Path
        Result folder.
    base : sequence of KeptTrial, optional
        What we read from this file or wrote into it last; None if it is new to us: then trials of
        other frames in it are replaced.

    Returns
    -------
    int
        How many trials of other frames were replaced.

    Raises
    ------
    InspectionError
        If it can't be written, or has become a list of other frames; then the file is as it was.
    """
    if not folder.is_dir():
        raise InspectionError(
            f"The trials can't be written to {folder}: the folder is gone; save the result again."
        )
    frames = {trial.frames for trial in trials}
    with changing(folder):
        theirs: Sequence[KeptTrial] = ()
        with suppress(InspectionError):  # a damaged list was told when it was read
            theirs = read_trials(folder)
        known = {_key(trial) for trial in base or ()}
        # A list that we know may have moved along with its frames.
        others = [t for t in theirs if t.frames not in frames and _key(t) not in known]
        if base is not None:
            others = [trial for trial in others if trial.frames]  # earlier versions did not say it
        if base is not None and others:
            raise InspectionError(
                f"Another window has saved a result of other frames to {folder}: the trials of "
                "this one are not kept there; save it to another folder."
            )
        same = [trial for trial in theirs if trial not in others]
        kept = worth_keeping(merged(trials, base or (), same))
        replace_file(folder / TRIALS_NPZ, _content(kept))
    return len(others)


def _content(kept: Sequence[KeptTrial]) -> bytes:
    about = [
        {
            "format": _TrialRecord.newest_format,
            "number": trial.number,
            "settings": trial.settings.model_dump(mode="json", exclude_none=True),
            "cell": trial.cell,
            "caption": trial.caption,
            "text": trial.text,
            "name": trial.name,
            "frames": trial.frames,
        }
        for trial in kept
    ]
    pictures = {f"picture_{k}": trial.image.astype(np.float16) for k, trial in enumerate(kept)}
    content = io.BytesIO()
    np.savez(content, about=np.array(json.dumps(about)), **pictures)  # type: ignore[arg-type]
    return content.getvalue()


def _text(stored: NDArray[np.generic]) -> str:
    """Return the text of an array of one; numpy makes strings of any numbers, also impossible."""
    if stored.dtype.kind != "U" or stored.size != 1:
        raise TypeError("its list of trials is no text")
    native = stored.astype(stored.dtype.newbyteorder("=")).reshape(1)
    if native.itemsize and int(native.view(np.uint32).max()) > sys.maxunicode:
        raise ValueError("its list of trials has characters that do not exist")
    return str(native[0])


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
            about = json_from(_text(file["about"]))
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


class _TrialRecord(StoredRecord):
    newest_format: ClassVar[int] = 2

    number: Whole
    settings: dict[str, Any]
    cell: tuple[Place, Place]
    caption: Text
    text: Text
    name: Text
    frames: Text = ""


def _trial(record: _TrialRecord, picture: NDArray[np.generic]) -> KeptTrial:
    if picture.ndim != 2 or picture.dtype != np.float16 or min(picture.shape) < 1:
        raise ValueError("a picture is none")
    return KeptTrial(
        record.number,
        settings_of(record.settings, record.format),
        np.nan_to_num(picture.astype(np.float32)),
        record.cell,
        record.caption,
        record.text,
        record.name,
        record.frames,
    )
