"""Creates the file of a log, which belongs to its recorder alone."""

# A recorder must not take from another what that one has written, nor from the user what is no
# file: a device, a pipe. So a log is a regular file that was not there, or one that the user lets
# go and that no recorder has open. A symbolic link is followed and stays.
#
# The lock is the kernel's own (flock), on the file itself: it ends with the process, however that
# ends, and leaves nothing behind. A file that is replaced is emptied only once it is locked. Where
# a system or a file system has no such locks (Windows, some network shares), recorders go without.

from __future__ import annotations

import os
import stat
import sys
from pathlib import Path
from typing import BinaryIO

from mbtool.core import OutputError, UsageError

if sys.platform != "win32":
    import fcntl


def create_file(path: Path, *, replace: bool = False) -> BinaryIO:
    """An empty file, open for writing, unbuffered, and locked until it is closed.

    Raises UsageError for what cannot be created or may not be replaced, OutputError where another
    recorder has the file.
    """
    demand_place(path, replace=replace)
    try:
        place = Path(os.path.realpath(path))
        flags = os.O_WRONLY | os.O_CREAT | (0 if replace else os.O_EXCL)
        descriptor = os.open(place, flags | getattr(os, "O_BINARY", 0), 0o666)
    except FileExistsError:
        raise _exists(path) from None
    except (OSError, ValueError) as error:
        raise _uncreated(path, error) from error
    file = open(descriptor, "wb", buffering=0)  # noqa: SIM115 - the caller closes it
    try:
        _lock(file, path)
        file.truncate(0)
    except OSError as error:
        file.close()
        raise _uncreated(path, error) from error
    except OutputError:
        file.close()
        raise
    if os.name == "posix":
        _sync_folder(place.parent)
    return file


def demand_place(path: Path, *, replace: bool = False) -> None:
    """See that a log may stand there, and create nothing. Raises UsageError."""
    try:
        mode = path.stat().st_mode
    except FileNotFoundError as error:
        if not Path(os.path.realpath(path)).parent.is_dir():
            raise _uncreated(path, error) from error
        return
    except (OSError, ValueError) as error:
        raise _uncreated(path, error) from error
    if stat.S_ISDIR(mode):
        raise UsageError(f"{path}: a directory; name a file in it, for example {path / 'x.mcap'}")
    if not stat.S_ISREG(mode):
        raise UsageError(f"{path}: no regular file, so no log can be kept in it; name another")
    if not replace:
        raise _exists(path)


def _lock(file: BinaryIO, path: Path) -> None:
    """Raise OutputError where another recorder has the file."""
    if sys.platform == "win32":
        return
    try:
        fcntl.flock(file.fileno(), fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        raise OutputError(
            f"{path}: another recorder is writing to it; name another, or end that one first"
        ) from None
    except OSError:
        return  # A file system without locks.


def _exists(path: Path) -> UsageError:
    return UsageError(
        f"{path}: the file exists, and a recording is not overwritten; "
        "name another, or let sniff replace it with --overwrite"
    )


def _uncreated(path: Path, error: OSError | ValueError) -> UsageError:
    reason = getattr(error, "strerror", None) or str(error)
    return UsageError(f"{path}: the log cannot be created: {reason}")


def _sync_folder(folder: Path) -> None:
    """Make the file's name last through a power cut."""
    try:
        descriptor = os.open(folder, os.O_RDONLY)
    except OSError:
        return  # A folder that may be written and not read: the name lasts when the kernel says so.
    try:
        os.fsync(descriptor)
    except OSError:
        return
    finally:
        os.close(descriptor)
