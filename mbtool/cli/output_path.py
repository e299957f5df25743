"""Reads the name of an output file: its format, and whether it may be written."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TypeVar

from mbtool.cli.talk import say
from mbtool.core import UsageError

STANDARD_OUTPUT = "-"
_STDIN = 0
"""The file descriptor of standard input."""

F = TypeVar("F")


def named_file(path: str | None) -> str | None:
    """Return the file of --output; None for standard output.

    Raises UsageError for an empty name and for a directory.
    """
    if path is None or path == STANDARD_OUTPUT:
        return None
    if not path:
        raise UsageError("--output has an empty name; name a file, or - for standard output")
    if os.path.isdir(path):
        raise UsageError(f"{path}: a directory; name a file in it")
    return path


def chosen_format(given: F | None, path: str | None, suffixes: Mapping[str, F], default: F) -> F:
    """Return the format of --format (`given`), or else the one that the suffix of `path` names.

    `suffixes` maps each suffix, such as `.csv`, to its format. `default` is returned for standard
    output (`path` None). Says so if the suffix names another format than --format. Raises
    UsageError if there is no --format, and the suffix names no format.
    """
    suffix = "" if path is None else Path(path).suffix.lower()
    if given is not None:
        # SARIF is JSON, too.
        if suffixes.get(suffix, given) != given and suffix != ".json":
            say(f"{path}: written as {given}, as --format says, though its name ends in {suffix}")
        return given
    if path is None:
        return default
    try:
        return suffixes[suffix]
    except KeyError:
        raise UsageError(
            f"{path}: its suffix names no format; let it end in {', '.join(suffixes)}, "
            "or add --format"
        ) from None


def demand_new(path: str | None, *, overwrite: bool) -> None:
    """Raise UsageError if a file `path` exists, unless `overwrite`, which goes only with a file.

    None is standard output.
    """
    if path is None and overwrite:
        raise UsageError("--overwrite replaces a file, and none is named to write to")
    if path is not None and not overwrite and os.path.isfile(path):
        raise UsageError(
            f"{path}: the file exists; name another, remove it, or replace it with --overwrite"
        )


def demand_other_file(files: Sequence[str], output: str | None) -> None:
    """Raise UsageError if the output file is also one of the inputs."""
    for file in files:
        if output is not None and is_same_file(file, output):
            raise UsageError(f"{output}: is an input and would be overwritten; name another file")


def is_same_file(file: str, output: str) -> bool:
    """True if two paths name one file, of which `output` is to be written; "-" is standard input or
    output.
    """
    if output == STANDARD_OUTPUT:
        return False
    try:
        return os.path.samefile(_STDIN if file == STANDARD_OUTPUT else file, output)
    except OSError:  # One of the two files does not exist.
        return os.path.abspath(file) == os.path.abspath(output)
