"""Replaces a file in one step: a crash or a power cut leaves the old file or the new one."""

# The new content is written to a second file in the same folder, which is synced to the disk and
# renamed to the old file's name. Then the folder is synced, so when the replacement returns, the
# new file survives a power cut. If the process is killed before the renaming, the second file
# stays. Its name is .NAME.PID.part; the next process with the same id (in a container always 1)
# that replaces the same file overwrites it. If one program writes a file again and again, its name
# is .NAME.new.

from __future__ import annotations

import errno
import os
import stat
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from mbtool.core.errors import OutputError, UsageError, reason_of


def move_into_place(new: Path, target: Path) -> None:
    """Rename the file `new` to `target` in its folder, and return when both are on the disk.

    Raises OSError if that is not possible; `target` is unchanged then, except if the disk cannot
    sync the folder.
    """
    with new.open("rb+", buffering=0) as file:
        os.fsync(file.fileno())
    os.replace(new, target)
    sync_folder(target.parent)


def replace_content(target: Path, content: bytes) -> None:
    """Create a file, or replace its content in one step.

    Raises OSError if that is not possible; an old file is unchanged then.
    """
    beside = target.with_name(f".{target.name}.new")
    try:
        beside.write_bytes(content)
        move_into_place(beside, target)
    except OSError:
        with suppress(OSError):
            beside.unlink()
        raise


def make_folder(folder: Path) -> None:
    """Create a folder, with those above it, if it is missing; they are on the disk then.

    Raises OSError if that is not possible.
    """
    missing = [one for one in (folder, *folder.parents) if not one.exists()]
    folder.mkdir(parents=True, exist_ok=True)
    for one in missing:
        sync_folder(one.parent)


_NO_SYNC = frozenset((errno.EINVAL, errno.ENOTSUP, errno.EOPNOTSUPP, errno.ENOSYS, errno.EBADF))
"""The errors with which a file system says that it cannot sync folders; they are ignored."""


def sync_folder(folder: Path) -> None:
    """Sync a folder to the disk, so that new and renamed files in it survive a power cut.

    A folder that this user may not read is left to the kernel. Raises OSError if the disk refuses.
    """
    if os.name != "posix":
        return
    try:
        descriptor = os.open(folder, os.O_RDONLY)
    except PermissionError:
        return
    try:
        os.fsync(descriptor)
    except OSError as error:
        if error.errno not in _NO_SYNC:
            raise
    finally:
        os.close(descriptor)


@contextmanager
def replacing(path: str | Path) -> Iterator[Path]:
    """Yield the path of an empty file that replaces the file at `path` when the context ends.

    Until then only its owner can read the new file; then it gets the old file's permissions. If
    `path` is a symbolic link, the file it leads to is replaced. If an error ends the context, the
    new file is deleted and the old one stays, which the text of an OutputError then says. Raises
    UsageError if the file at `path` cannot be replaced.
    """
    target = Path(os.path.realpath(path))
    if not os.access(target, os.W_OK):
        raise UsageError(f"{path}: cannot be written: Permission denied")
    beside = target.with_name(f".{target.name}.{os.getpid()}.part")
    _create(beside, path)
    try:
        yield beside
        try:
            _copy_rights(target, beside)
            move_into_place(beside, target)
        except OSError as error:
            raise OutputError(str(error)) from error
    except OutputError as error:
        refusal = _refusal(error)
        # If an OSError is the cause, only its text is shown. The text of the OutputError may name
        # the temporary file, or say that the data written so far can be read. Both would mislead
        # the user, as the temporary file is deleted.
        why = error if refusal is None else f"{path}: cannot be written: {reason_of(refusal)}"
        raise OutputError(f"{why}; {path} stays as it was") from error
    finally:
        with suppress(OSError):
            beside.unlink()


def _create(beside: Path, path: str | Path) -> None:
    """Create the empty file `beside` for the new content of the file at `path`.

    A file of that name, which a killed process left there, is deleted first.
    """
    try:
        beside.unlink(missing_ok=True)
        os.close(os.open(beside, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600))
    except PermissionError as error:
        raise UsageError(f"{path}: cannot be replaced: its folder cannot be written") from error
    except OSError as error:
        raise UsageError(f"{path}: cannot be replaced: {reason_of(error)}") from error


def _copy_rights(old: Path, new: Path) -> None:
    status = old.stat()
    if hasattr(os, "chown"):
        with suppress(OSError):  # Only root may give a file to another user.
            os.chown(new, status.st_uid, status.st_gid)
    new.chmod(stat.S_IMODE(status.st_mode))


def _refusal(error: BaseException | None) -> OSError | None:
    """Return the first OSError among an error and its causes; None if there is none."""
    while error is not None and not isinstance(error, OSError):
        error = error.__cause__
    return error
