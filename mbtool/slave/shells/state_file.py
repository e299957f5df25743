"""Keeps the non-volatile registers of a simulated device in a file between two runs."""

# The file is TOML with the device's references as keys, like a file of start values
# (image_file.py). It is written when a non-volatile register has changed, before the master gets
# the response, and is on the disk then (core/replacing.py). The process locks the file, and each
# new one that replaces it; another process is refused. While a file is replaced, its folder is
# locked, so that no process can lock the new file before.

from __future__ import annotations

import errno
import json
import os
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from typing import TYPE_CHECKING

from mbtool.core import InputError, OutputError, UsageError
from mbtool.core.errors import reason_unwritten
from mbtool.core.replacing import replace_content
from mbtool.devices import Profile, write_reference
from mbtool.slave.device.image_file import load_image

if sys.platform != "win32":
    import fcntl

if TYPE_CHECKING:
    from pathlib import Path

    from mbtool.slave.device.responder import DeviceResponder


def keep_state(
    path: Path,
    profile: Profile,
    device: DeviceResponder,
    on_trouble: Callable[[str], None],
) -> None:
    """Load a device's state from a file, if it exists, and save the state there at each change.

    Raises UsageError for a device without non-volatile registers, for a file with keys for other
    registers and for one that cannot be written, InputError for one that cannot be read, and
    OutputError if the disk is full. If a later write fails, the device continues, and `on_trouble`
    gets a line for the user.
    """
    kept = device.behaviour.kept
    if not kept:
        raise UsageError(f"{profile.name} keeps nothing over a restart, so --state has no use")
    path = _resolved(path)
    if path.exists():
        if not path.is_file():
            raise UsageError(f"{path}: is no file; --state wants one that can be written anew")
        with _locked_folder(path.parent):
            _lock(path)
        load_image(path, profile, device.image, kept)

    def save() -> None:
        lines = [f"# What {profile.name} keeps over a restart.\n"]
        for table, span in kept:
            values = device.image.get(table, span.start, len(span))
            lines += [
                f"{_key(write_reference(profile, table, address))} = {value}\n"
                for address, value in zip(span, values, strict=True)
            ]
        with _locked_folder(path.parent):
            if path.exists():
                _lock(path)
            replace_content(path, "".join(lines).encode())
            _lock(path)

    def keep() -> None:
        try:
            save()
        except OSError as error:
            on_trouble(f"{path}: not written: {error.strerror or error}; its state is not kept")
        except UsageError as error:  # Somebody replaced the file, and another slave keeps it now.
            on_trouble(str(error))

    try:
        save()
    except OSError as error:
        is_full = error.errno in (errno.ENOSPC, errno.EDQUOT)
        problem = f"{path}: cannot be written: {reason_unwritten(path, error)}"
        raise (OutputError(problem) if is_full else UsageError(problem)) from error
    device.behaviour.keep = keep


_locked: dict[Path, int] = {}
"""By path, the descriptor that holds the lock of each state file of this process."""


@contextmanager
def _locked_folder(folder: Path) -> Iterator[None]:
    """Wait until no other process replaces a state file in a folder, and let none do so meanwhile.

    There is no lock on Windows, and where the file system has none.
    """
    if sys.platform == "win32":
        yield
        return
    opened = os.open(folder, os.O_RDONLY)
    try:
        with suppress(OSError):
            fcntl.flock(opened, fcntl.LOCK_EX)
        yield
    finally:
        os.close(opened)


def _lock(path: Path) -> None:
    """Lock the state file until the process ends or locks it anew; there is no lock on Windows.

    Raises UsageError if another process has locked it.
    """
    if sys.platform == "win32":
        return
    if path in _locked:
        os.close(_locked.pop(path))
    with suppress(OSError):  # Where it cannot be written, `save` tells why.
        opened = os.open(path, os.O_RDWR)
        try:
            fcntl.flock(opened, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            os.close(opened)
            if not isinstance(error, BlockingIOError):  # The file system has no locks.
                return
            raise UsageError(
                f"{path}: another slave keeps its state there; name another file, or end that one "
                "first"
            ) from None
        _locked[path] = opened


def _resolved(path: Path) -> Path:
    """Return the path without symbolic links. Raises InputError if they cannot be followed."""
    try:
        path = path.resolve()
        path.exists()
    except (OSError, RuntimeError) as error:  # No permission, or links in a circle.
        reason = getattr(error, "strerror", None) or error
        raise InputError(f"{path}: cannot be read: {reason}") from error
    return path


def _key(reference: str) -> str:
    return reference if reference.isalnum() and reference.isascii() else json.dumps(reference)
