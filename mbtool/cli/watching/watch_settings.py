"""The settings that `watch` remembers from run to run: columns, sorting, filters."""

# The settings are one JSON file in the user's config folder. A file that cannot be read or is wrong
# is ignored; the next change replaces it.

from __future__ import annotations

import os
import sys
from pathlib import Path

import msgspec

MAX_FILTERS = 20


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


def load_settings() -> WatchSettings:
    try:
        return msgspec.json.decode(settings_path().read_bytes(), type=WatchSettings)
    except (OSError, RuntimeError, msgspec.DecodeError):
        return WatchSettings()


def save_settings(settings: WatchSettings) -> str | None:
    """Write the settings file; return None, or a line for the user if that fails."""
    try:
        path = settings_path()
        path.parent.mkdir(parents=True, exist_ok=True)
        beside = path.with_suffix(".new")
        beside.write_bytes(msgspec.json.format(msgspec.json.encode(settings)))
        beside.replace(path)
    except (OSError, RuntimeError) as error:
        return f"not remembered: {error}"
    return None
