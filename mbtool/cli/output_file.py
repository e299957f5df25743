"""Opens the file of --output, and tells the user what the file contains after an error."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TextIO

from mbtool.cli.talk import NOTHING_WRITTEN, say, say_if_interrupted
from mbtool.core import InputError, OutputError, UsageError
from mbtool.core.errors import reason_unwritten
from mbtool.core.replacing import replacing


def is_old(path: str | None) -> bool:
    """True if a file `path` exists already. None stands for standard output, which is not old."""
    return path is not None and os.path.isfile(path)


def demand_writable(file: Path) -> None:
    """Raise UsageError, before a long run, if a file cannot be written; leave no file behind."""
    if file.exists() and not (file.is_file() or file.is_dir()):
        return  # Opening a pipe would wait until somebody reads it.
    was_there = file.exists() or file.is_symlink()
    try:
        file.open("ab").close()
        if not was_there:
            file.unlink()
    except OSError as error:
        raise UsageError(f"{file}: cannot be written: {reason_unwritten(file, error)}") from error


@contextmanager
def report_kept(path: str | None) -> Iterator[None]:
    """Tell the user that an existing file `path` stays as it was if InputError ends the context."""
    has_old = is_old(path)
    try:
        yield
    except InputError:
        if has_old:
            say(f"{path} stays as it was")
        raise


@contextmanager
def report_left(path: str | None) -> Iterator[None]:
    """Tell the user what there is at `path`, a file that is written, if Ctrl-C ends the context."""
    has_old = is_old(path)

    def left() -> str:
        if has_old:
            return f"interrupted; {path} stays as it was"
        return f"interrupted; {path} ends early" if is_old(path) else NOTHING_WRITTEN

    with say_if_interrupted(left):
        yield


@contextmanager
def open_file(path: str | None, *, in_place: bool) -> Iterator[TextIO]:
    """Open a file to write text to; standard output if `path` is None.

    A file of that name is replaced when the context ends, and stays if it ends by an error; with
    `in_place` it is overwritten at once. Raises UsageError if the file cannot be opened.
    """
    if path is not None and is_old(path):
        from mbtool.logs.creating import demand_unlocked

        demand_unlocked(Path(path))
    if path is None:
        yield sys.stdout
    elif is_old(path) and not in_place:
        with replacing(path) as beside, _open_for(path, beside) as file:
            yield file
    else:
        with _left_if_begun(path), _open_for(path, Path(path)) as file:
            yield file


def emptied(file: TextIO) -> None:
    """Take back what was written to a file of `open_file`, which then leaves no new file."""
    with suppress(OSError):  # A pipe cannot be emptied.
        file.seek(0)
        file.truncate()


@contextmanager
def _open_for(path: str, place: Path) -> Iterator[TextIO]:
    """Open the file `place` for text; error messages call it `path`."""
    try:
        file = place.open("w", encoding="utf-8", newline="")
    except OSError as error:
        raise UsageError(f"{path}: cannot be written: {reason_unwritten(path, error)}") from error
    try:
        yield file
    finally:
        with suppress(OSError):  # Flushing has already raised the error.
            file.close()


@contextmanager
def _left_if_begun(path: str) -> Iterator[None]:
    """If an error ends the context, delete a new file that is empty.

    If the file has content, the message of an OutputError says that it ends early.
    """
    is_new = not os.path.lexists(path)
    try:
        yield
    except BaseException as error:
        size = os.path.getsize(path) if os.path.isfile(path) else 0
        if is_new and not size:
            with suppress(OSError):
                os.unlink(path)
        if size and isinstance(error, OutputError):
            raise OutputError(f"{error}; it ends early, after {size} bytes") from error
        raise
