"""Reads the inputs and writes the profiles of `mbtool devices new`, `import` and `draft`."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from mbtool.cli.output_file import is_old, open_file
from mbtool.cli.output_path import demand_new as demand_new_file
from mbtool.cli.output_path import named_file
from mbtool.cli.talk import say
from mbtool.core import InputError, UsageError
from mbtool.core.errors import reason_unwritten
from mbtool.core.moments import counted

if TYPE_CHECKING:
    from mbtool.devices.importing.register_list import ImportedList

_SUFFIX = ".toml"
_STANDARD = "-"

OutputOption = Annotated[
    str | None,
    typer.Option(
        "--output",
        "-o",
        metavar="FILE.toml",
        help="Write to a new file. [default: standard output]",
    ),
]


def profile_name(file: str, output: str | None) -> str | None:
    """Return a profile name, made from the name of the output file, or else of the input file.

    Returns None if that file is `-`, a standard stream. `output` is None if not given.
    """
    from mbtool.devices.profile_template import name_for

    return name_for(output or file) if _STANDARD not in (output or file,) else None


def give_imported(imported: ImportedList, output: str | None, *, overwrite: bool) -> None:
    for remark in imported.remarks:
        say(remark)
    give(imported.text, output, overwrite=overwrite)
    if is_file(output):
        say(f"{counted(len(imported.profile.points), 'point')} -> {output}")


def read_input(file: str) -> bytes:
    from mbtool.devices.importing.register_list import MAX_BYTES

    try:
        if file == _STANDARD:
            if sys.stdin is None:
                raise InputError("standard input: closed; name a file")
            return sys.stdin.buffer.read(MAX_BYTES + 1)
        with Path(file).open("rb") as stream:
            return stream.read(MAX_BYTES + 1)
    except OSError as error:
        raise InputError(f"{file}: cannot be read: {error.strerror or error}") from error


def shown(file: str) -> str:
    return "standard input" if file == _STANDARD else file


def is_file(output: str | None) -> bool:
    return output is not None and output != _STANDARD


def demand_new(
    output: str | None, suffixes: Sequence[str] = (_SUFFIX,), *, overwrite: bool
) -> None:
    """Raise UsageError if a profile cannot be written to a file of this name.

    `output` must have one of the suffixes. It must not exist, as the user may have edited it,
    except with `overwrite`. None and `-` stand for standard output.
    """
    output = named_file(output)
    demand_new_file(output, overwrite=overwrite)
    if output is None:
        return
    if not output.lower().endswith(tuple(suffixes)):
        what = (
            "a profile is a TOML file" if _SUFFIX in suffixes else "the suffix is of another form"
        )
        raise UsageError(f"{output}: {what}; let its name end in {' or '.join(suffixes)}")


def give(
    text: str, output: str | None, suffixes: Sequence[str] = (_SUFFIX,), *, overwrite: bool
) -> None:
    if output is None or output == _STANDARD:
        typer.echo(text, nl=False)
    else:
        write(output, text, suffixes, overwrite=overwrite)


def write(file: str, text: str, suffixes: Sequence[str] = (_SUFFIX,), *, overwrite: bool) -> None:
    demand_new(file, suffixes, overwrite=overwrite)
    if is_old(file):
        with open_file(file, in_place=False) as stream:
            stream.write(text)
        return
    try:
        # Mode "x" does not overwrite a file that was made after the check of demand_new.
        with Path(file).open("x", encoding="utf-8") as stream:
            stream.write(text)
    except OSError as error:
        raise UsageError(f"{file}: cannot be written: {reason_unwritten(file, error)}") from error
