"""Prints the manual page of mbtool, from the help texts: python -m tests.docs.man_page."""

from __future__ import annotations

import re
import sys
from typing import TYPE_CHECKING, Any

from typer.main import get_command

from mbtool.cli.examples import examples_of
from mbtool.cli.main import app
from mbtool.version import __version__

if TYPE_CHECKING:
    from collections.abc import Iterator

_CODES = (
    ("0", "done"),
    ("1", "the answer is no: findings, differences, something new, something lost"),
    ("2", "wrong usage"),
    ("3", "an input could not be read, a link not opened, or an output takes no more"),
    ("130", "interrupted"),
)
_UNWRAPPED = 10_000
"""Columns of a usage line, which roff wraps by itself."""


def man_page() -> str:
    """The page, for the program man."""
    root: Any = get_command(app)
    parts = [
        f'.TH MBTOOL 1 "" "mbtool {__version__}" "User Commands"',
        ".SH NAME\nmbtool \\- capture, decode and replay Modbus",
        ".SH SYNOPSIS\n.B mbtool\n.I COMMAND\n[\\fIOPTIONS\\fR] [\\fIARGUMENTS\\fR]",
        f".SH DESCRIPTION\n{_text(root.help)}",
        ".SH COMMANDS",
    ]
    for names, command in _commands(root, ("mbtool",)):
        parts += _command(names, command)
    parts.append(".SH EXIT STATUS")
    parts += [f".TP\n.B {code}\n{_text(meaning)}" for code, meaning in _CODES]
    return "\n".join(parts) + "\n"


def _commands(group: Any, names: tuple[str, ...]) -> Iterator[tuple[tuple[str, ...], Any]]:
    for name in group.commands:
        command = group.commands[name]
        if command.hidden:
            continue
        yield (*names, name), command
        if hasattr(command, "commands"):
            yield from _commands(command, (*names, name))


def _command(names: tuple[str, ...], command: Any) -> Iterator[str]:
    name = " ".join(names)
    context = command.context_class(
        command, info_name=name, terminal_width=_UNWRAPPED, max_content_width=_UNWRAPPED
    )
    yield f".SS {_text(name)}"
    for line in command.get_usage(context).splitlines():
        arguments = line.removeprefix("Usage: ").removeprefix(name)
        yield f".B {_text(name)}\n{_text(arguments)}\n.br"
    yield f".PP\n{_text(command.help or '')}"
    for param in command.get_params(context):
        record = param.get_help_record(context)
        if record is not None and "--help" not in record[0]:
            shown = re.sub(r" <.*>$", "", record[0]) if record[0][0] != "-" else record[0]
            yield f".TP\n.B {_text(shown)}\n{_text(record[1])}"
    examples = examples_of(name)
    if examples is not None:
        yield ".PP\nExamples:\n.PP\n.nf"
        yield from (f"    {_text(line)}" for line in examples[1:] if line)
        yield ".fi"


def _text(text: str) -> str:
    """A text as roff takes it: paragraphs, and no character that has a meaning there."""
    paragraphs = [" ".join(one.split()) for one in re.split(r"\n\s*\n", text.strip())]
    escaped = "\n.PP\n".join(paragraphs).replace("\\", "\\e").replace("-", "\\-")
    return re.sub(r"(?m)^(['.])(?!PP$)", r"\\&\1", escaped)


if __name__ == "__main__":
    sys.stdout.write(man_page())
