"""Creates and locks the file of a log."""

# A recorder must not overwrite a file that another recorder is writing, nor write to a device or a
# pipe. So a log is a new regular file, or an existing one that the user allows to be replaced and
# that no recorder has open. A symbolic link is followed and stays.
#
# The lock is the kernel's (flock), on the file itself. It ends with the process, even if that is
# killed, and leaves no lock file behind. A file that is replaced is emptied only after it is
# locked. There is no lock on Windows and on file systems without flock (some network shares).

from __future__ import annotations

import errno
import os
import stat
import sys
from pathlib import Path
from typing import BinaryIO

from mbtool.core import OutputError, UsageError
from mbtool.core.errors import reason_unwritten
from mbtool.core.replacing import sync_folder

if sys.platform != "win32":
    import fcntl


def create_file(path: Path, *, replace: bool = False) -> BinaryIO:
    """Create an empty file, open for writing, unbuffered, and locked until it is closed.

    With `replace` an existing file is emptied. Raises UsageError if the file exists and `replace`
    is False, or if it cannot be created. Raises OutputError if another recorder has it open.
    """
    check_path(path, replace=replace)
    try:
        target = Path(os.path.realpath(path))
        flags = os.O_WRONLY | os.O_CREAT | (0 if replace else os.O_EXCL)
        descriptor = os.open(target, flags | getattr(os, "O_BINARY", 0), 0o666)
    except FileExistsError:
        raise _exists(path) from None
    except (OSError, ValueError) as error:
        raise _creation_error(path, error) from error
    file = open(descriptor, "wb", buffering=0)  # noqa: SIM115 - the caller closes it
    try:
        _lock(file, path)
        file.truncate(0)
        sync_folder(target.parent)
    except OSError as error:
        file.close()
        raise _creation_error(path, error) from error
    except OutputError:
        file.close()
        raise
    return file


def check_path(path: Path, *, replace: bool = False) -> None:
    """Raise UsageError if no log can be created at a path; create nothing.

    An existing file is an error unless `replace` is True.
    """
    try:
        mode = path.stat().st_mode
    except FileNotFoundError as error:
        folder = Path(os.path.realpath(path)).parent
        if not folder.is_dir():
            raise _creation_error(path, error) from error
        if not os.access(folder, os.W_OK):
            raise _creation_error(
                path, PermissionError(errno.EACCES, os.strerror(errno.EACCES))
            ) from None
        return
    except (OSError, ValueError) as error:
        raise _creation_error(path, error) from error
    if stat.S_ISDIR(mode):
        raise UsageError(f"{path}: a directory; name a file in it, for example {path / 'x.mcap'}")
    if not stat.S_ISREG(mode):
        raise UsageError(f"{path}: not a regular file; name another")
    if not replace:
        raise _exists(path)


def demand_unlocked(path: Path) -> None:
    """Raise OutputError if a recorder has locked the file at `path`.

    A file that is absent or may not be written counts as not locked.
    """
    try:
        with path.open("rb+", buffering=0) as file:
            _lock(file, path, is_shared=True)
    except OSError:
        return  # It cannot be opened for writing, so it counts as not being written.


def _lock(file: BinaryIO, path: Path, *, is_shared: bool = False) -> None:
    """Lock the file until it is closed. Raises OutputError if another recorder has locked it.

    With `is_shared` the lock is a shared one, which only tests for a recorder's lock.
    """
    if sys.platform == "win32":
        return
    try:
        kind = fcntl.LOCK_SH if is_shared else fcntl.LOCK_EX
        fcntl.flock(file.fileno(), kind | fcntl.LOCK_NB)
    except BlockingIOError:
        raise OutputError(
            f"{path}: another recorder is writing to it; name another, or end that one first"
        ) from None
    except OSError:
        return  # This file system has no locks.


def _exists(path: Path) -> UsageError:
    return UsageError(
        f"{path}: the file exists, and a recording is not overwritten; "
        "name another, remove it, or replace it with --overwrite"
    )


def _creation_error(path: Path, error: OSError | ValueError) -> UsageError:
    return UsageError(f"{path}: cannot be created: {reason_unwritten(path, error)}")
