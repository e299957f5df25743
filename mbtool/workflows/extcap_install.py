"""Installs the scripts by which Wireshark finds `mbtool extcap`, and removes them."""

# Wireshark starts each program in its folders for extcap. Up to version 4.0 the folder of a user is
# among the settings of Wireshark, from 4.2 on it is beside the user's plugins. So a script is
# installed in both:
#
#     Linux, macOS   ~/.config/wireshark/extcap (XDG_CONFIG_HOME), ~/.local/lib/wireshark/extcap
#     Windows        %APPDATA%\Wireshark\extcap
#
# The script starts mbtool with the Python that runs now. It contains a comment that mbtool made it;
# only files with this comment are replaced or removed.

from __future__ import annotations

import shlex
import sys
from collections.abc import Mapping
from pathlib import Path

from mbtool.core import UsageError
from mbtool.core.errors import reason_of

NAME = "mbtool-extcap"
_MARK = "made by mbtool extcap --install"
_MAX_SCRIPT_BYTES = 4096


def scripts(environment: Mapping[str, str], platform: str = sys.platform) -> list[Path]:
    """Return the paths at which the scripts belong. `environment` has the environment variables;
    `platform` is the system, as sys.platform names it.

    Raises UsageError if the user's home folder is unknown.
    """
    if platform == "win32":
        if not environment.get("APPDATA"):
            raise UsageError("APPDATA is not set, so the folder of Wireshark is not known")
        return [Path(environment["APPDATA"], "Wireshark", "extcap", f"{NAME}.bat")]
    if not environment.get("HOME"):
        raise UsageError("HOME is not set, so the folders of Wireshark are not known")
    home = Path(environment["HOME"])
    settings = Path(environment.get("XDG_CONFIG_HOME") or home / ".config")
    return [
        settings / "wireshark" / "extcap" / NAME,
        home / ".local" / "lib" / "wireshark" / "extcap" / NAME,
    ]


def install(paths: list[Path], python: str = sys.executable) -> None:
    """Write a script to each of `paths`, which starts mbtool with the interpreter `python`.

    Raises UsageError if a script cannot be written, or if there is a file that mbtool did not make.
    """
    for path in paths:
        _demand_own(path)
    for path in paths:
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(_script(path, python), encoding="utf-8")
            path.chmod(0o755)
        except OSError as error:
            raise UsageError(f"{path}: cannot be written: {reason_of(error)}") from error


def uninstall(paths: list[Path]) -> list[Path]:
    """Remove the scripts at `paths`, and return the paths at which there was one.

    Raises UsageError if a file there cannot be removed, or was not made by mbtool.
    """
    there = [path for path in paths if path.exists()]
    for path in there:
        _demand_own(path)
    for path in there:
        try:
            path.unlink()
        except OSError as error:
            raise UsageError(f"{path}: cannot be removed: {reason_of(error)}") from error
    return there


def _demand_own(path: Path) -> None:
    """Raise UsageError if there is a file at `path` that mbtool did not make."""
    if not path.exists():
        return
    try:
        with path.open("rb") as file:
            is_own = _MARK.encode() in file.read(_MAX_SCRIPT_BYTES)
    except OSError as error:
        raise UsageError(f"{path}: cannot be read: {reason_of(error)}") from error
    if not is_own:
        raise UsageError(f"{path}: was not made by mbtool; remove it or give it another name")


def _script(path: Path, python: str) -> str:
    if path.suffix == ".bat":
        return f'@echo off\nrem {_MARK}\n"{python}" -m mbtool extcap %*\n'
    return f'#!/bin/sh\n# {_MARK}\nexec {shlex.quote(python)} -m mbtool extcap "$@"\n'
