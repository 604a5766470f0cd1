"""Settings that are good for more than one module, as TOML files. No Qt."""

from __future__ import annotations

import re
from pathlib import Path

from napari_pv_inspect.user_state import presets_folder
from pv_inspect.errors import InspectionError
from pv_inspect.settings import Group, Settings
from pv_inspect.storage.folders import replace_file

__all__ = ["PRESET_FIELDS", "PresetStore", "read_preset", "write_preset"]

PRESET_FIELDS = (*Settings.names_in(Group.IMAGE), *Settings.names_in(Group.CRACKS))
"""Fields of a preset: nothing about one module, its frames or its camera."""

SUFFIX = ".toml"
LONGEST = 60
# What some system does not take in the name of a file.
_FORBIDDEN = re.compile(r'[\x00-\x1f<>:"/\\|?*]|^\.|\.$')
_DEVICES = re.compile(r"(con|prn|aux|nul|com\d|lpt\d)(\..*)?", re.IGNORECASE)


def write_preset(settings: Settings, path: Path) -> None:
    """Write a preset; the file is whole or, if anything fails, as it was.

    Raises
    ------
    InspectionError
        If it can't be written.
    """
    replace_file(path, settings.to_toml(PRESET_FIELDS).encode())


def read_preset(path: Path) -> Settings:
    """Read a preset; what it leaves out is automatic or usual.

    Any settings file will do; its fields about a module are not taken over (`PRESET_FIELDS`).

    Raises
    ------
    InspectionError
        If it is no settings file.
    """
    return Settings.from_toml(path)


class PresetStore:
    """The user's presets by name, one file each.

    Parameters
    ----------
    folder : Path, optional
        Where they lie; made with the first one. Default: the user's folder for configuration.
    """

    def __init__(self, folder: Path | None = None) -> None:
        self.folder = folder or presets_folder()

    def names(self) -> list[str]:
        """Return the names of all presets, in alphabetical order."""
        try:
            files = [path for path in self.folder.iterdir() if path.suffix == SUFFIX]
        except OSError:
            return []
        names = [path.stem for path in files if not path.name.startswith(".")]
        return sorted(names, key=str.casefold)

    def known(self, name: str) -> str | None:
        """Return the preset that a name would replace; capitals make no difference."""
        same = (one for one in self.names() if one.casefold() == name.strip().casefold())
        return next(same, None)

    def read(self, name: str) -> Settings:
        """Read a preset.

        Raises
        ------
        InspectionError
            If it is gone or damaged.
        """
        return read_preset(self._path(name))

    def save(self, name: str, settings: Settings) -> str:
        """Write a preset, in place of one of the same name.

        Returns
        -------
        str
            The name without blanks around it.

        Raises
        ------
        InspectionError
            If the name can't be one of a file, or if it can't be written.
        """
        name = name.strip()
        taken = _DEVICES.fullmatch(name) or _FORBIDDEN.search(name)
        if not name or len(name) > LONGEST or taken or not name.isprintable():
            raise InspectionError(
                f"A preset can't be called {name!r}: use up to {LONGEST} letters, digits and "
                "blanks."
            )
        old = self.known(name)
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise InspectionError(
                f"{self.folder} can't be made ({error.strerror}): save the preset to a file."
            ) from None
        write_preset(settings, self._path(name))
        if old is not None and old != name and not self._path(old).samefile(self._path(name)):
            self.delete(old)
        return name

    def delete(self, name: str) -> None:
        """Remove a preset; nothing happens if it is gone already.

        Raises
        ------
        InspectionError
            If its file can't be removed.
        """
        try:
            self._path(name).unlink(missing_ok=True)
        except OSError as error:
            raise InspectionError(
                f"The preset {name!r} can't be removed ({error.strerror}): remove its file from "
                f"{self.folder}."
            ) from None

    def _path(self, name: str) -> Path:
        return self.folder / f"{name}{SUFFIX}"
