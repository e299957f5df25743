"""The settings that `watch` remembers from run to run: columns, sorting, filters."""

# The settings are one JSON file in the user's config folder. If the file cannot be used, the user
# is told, and the file is kept under another name when the next change writes a new one.

from __future__ import annotations

import os
import sys
from pathlib import Path

import msgspec

from mbtool.core import InputError
from mbtool.core.errors import reason_of
from mbtool.core.replacing import make_folder, replace_content

MAX_FILTERS = 20
_DAMAGED = ".damaged"
_WHAT = "columns, sorting and filters"


class WatchSettings(msgspec.Struct, omit_defaults=True):
    """The user's choices for the views of `mbtool watch`: columns, sorting, filters."""

    columns: dict[str, list[str]] = {}
    """The names of the columns of a view, by the view's name; a view that is absent has its usual
    columns."""
    sorted_by: dict[str, tuple[str, bool]] = {}
    """For a view: the column that its rows are sorted by, and True if the greatest value comes
    first."""
    filters: list[str] = []
    """The texts of the last filters, the newest first."""

    def note_filter(self, text: str) -> None:
        """Remember a filter as the newest one."""
        self.filters = [text, *(one for one in self.filters if one != text)][:MAX_FILTERS]


def settings_path() -> Path:
    """Return the path of the settings file (XDG Base Directory Specification)."""
    folder = os.environ.get("XDG_CONFIG_HOME") or ""
    if not os.path.isabs(folder):  # The specification says to ignore a relative path.
        local = os.environ.get("APPDATA") if sys.platform == "win32" else None
        folder = local or str(Path.home() / ".config")
    return Path(folder) / "mbtool" / "watch.json"


def load_settings() -> tuple[WatchSettings, str | None]:
    """Return the settings, and a line for the user if their file cannot be used, else None."""
    try:
        return _read(settings_path()) or WatchSettings(), None
    except RuntimeError:  # There is no home folder.
        return WatchSettings(), None
    except InputError as error:
        return WatchSettings(), f"{error}; {_WHAT} are the usual ones"


def save_settings(settings: WatchSettings) -> str | None:
    """Write the settings file; return None, or a line for the user if that fails.

    A file that cannot be used is kept under another name, which ends in _DAMAGED.
    """
    problem = f"{_WHAT} are not remembered: "
    try:
        path = settings_path()
    except RuntimeError:
        return f"{problem}there is no home folder"
    try:
        make_folder(path.parent)
        _keep_damaged(path)
        replace_content(path, msgspec.json.format(msgspec.json.encode(settings)))
    except (FileExistsError, NotADirectoryError):
        file = next(one for one in path.parents if one.exists())
        return f"{problem}{file} is a file, not a folder"
    except OSError as error:
        return f"{problem}{path.parent} cannot be written: {reason_of(error)}"
    return None


def _read(path: Path) -> WatchSettings | None:
    """Return the settings in a file; None if it is absent, InputError if it cannot be used."""
    try:
        return msgspec.json.decode(path.read_bytes(), type=WatchSettings)
    except (FileNotFoundError, NotADirectoryError):
        return None
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {reason_of(error)}") from error
    except UnicodeDecodeError:
        raise InputError(f"{path}: damaged: not UTF-8") from None
    except msgspec.DecodeError as error:
        raise InputError(f"{path}: damaged: {error}") from error


def _keep_damaged(path: Path) -> None:
    try:
        _read(path)
    except InputError:
        path.replace(path.with_name(f"{path.name}{_DAMAGED}"))
