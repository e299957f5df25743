"""Replaces a file in one step, so that a run that fails leaves the old file unchanged."""

# The new content is written to a second file in the same folder, .NAME.PID.part, which is renamed
# to the old file's name when it is complete. If the process is killed, the second file stays under
# its own name, until a process with the same id (in a container always 1) replaces the same file.

from __future__ import annotations

import os
import stat
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING

from mbtool.core.errors import OutputError, UsageError, reason_of

if TYPE_CHECKING:
    from collections.abc import Iterator


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
            os.replace(beside, target)
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
