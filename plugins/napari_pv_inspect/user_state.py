"""What the workbench keeps for its user beside the results: presets, the sample, who judges.

One place, the folders that the system has for it (platformdirs).
"""

from __future__ import annotations

from pathlib import Path

import platformdirs

from pv_inspect.common.records import StoredRecord, Text, checked, json_from, read_text
from pv_inspect.errors import InspectionError
from pv_inspect.storage.folders import replace_file

__all__ = ["UserState", "cache_folder", "presets_folder", "read_user_state", "write_user_state"]

APPLICATION = "pv-inspect"
FILE = "user.json"
_LARGEST_FILE_BYTES = 2**16


class UserState(StoredRecord):
    """What is remembered from one session to the next.

    Parameters
    ----------
    rater : str
        Who judges; "": nobody has said so yet.
    """

    rater: Text = ""


def presets_folder() -> Path:
    """Folder of the user's presets; it need not exist."""
    return _config_folder() / "presets"


def cache_folder() -> Path:
    """Folder for what can be made again; it need not exist."""
    return Path(platformdirs.user_cache_dir(APPLICATION))


def read_user_state() -> UserState:
    """Return what is remembered; what can't be read counts as forgotten."""
    try:
        text = read_text(_config_folder() / FILE, _LARGEST_FILE_BYTES)
        return checked(UserState, json_from(text))
    except (OSError, ValueError):
        return UserState()


def write_user_state(state: UserState) -> None:
    """Remember something for the next session.

    Raises
    ------
    InspectionError
        If the file can't be written.
    """
    folder = _config_folder()
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InspectionError(
            f"{folder} can't be made ({error.strerror}): allow writing there, or say again in the "
            "next session who judges."
        ) from None
    replace_file(folder / FILE, state.model_dump_json(indent=2).encode())


def _config_folder() -> Path:
    return Path(platformdirs.user_config_dir(APPLICATION))
