"""The examples that end each help, and the headings of its options."""

from __future__ import annotations

import re
import shlex
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
from typer.main import get_command

from mbtool.cli.examples import EXAMPLES, MOST_USED
from mbtool.cli.main import app

if TYPE_CHECKING:
    from tests.cli.program import CommandLine

DOCS = Path(__file__).resolve().parents[2] / "docs"
ROOT: Any = get_command(app)
LINES = [line for one in EXAMPLES.values() for line in one[1:]]


def _commands(group: Any, names: tuple[str, ...] = ()) -> list[str]:
    found = []
    for name, command in group.commands.items():
        if not command.hidden:
            found.append(" ".join((*names, name)))
            found += _commands(command, (*names, name)) if hasattr(command, "commands") else []
    return found


def test_each_command_has_examples_and_a_page() -> None:
    assert sorted(EXAMPLES) == sorted(_commands(ROOT))
    for one in EXAMPLES.values():
        assert (DOCS / f"{one.page}.md").exists(), one.page


@pytest.mark.parametrize("line", [*LINES, *(line for _, line in MOST_USED)])
def test_an_example_can_be_given(line: str) -> None:
    _, *arguments = shlex.split(line.partition(" > ")[0])
    context = ROOT.make_context("mbtool", list(arguments))
    name, command, rest = ROOT.resolve_command(context, arguments)
    with command.make_context(name, rest, parent=context):
        pass


@pytest.mark.parametrize("command", EXAMPLES)
def test_a_help_ends_with_its_examples_and_its_page(mbtool: CommandLine, command: str) -> None:
    told = mbtool(*command.split(), "--help").out
    _, _, end = told.partition("\nExamples:\n")
    examples = EXAMPLES[command]
    assert end.startswith("".join(f"  {line}\n" for line in examples[1:]))
    assert f"\nMore: docs/{examples.page}.md\n" in end


def test_options_stand_below_headings(mbtool: CommandLine) -> None:
    headings = re.findall(r"^([A-Z][\w ]+):$", mbtool("replay", "--help").out, re.MULTILINE)
    assert headings[:5] == [
        "Arguments",
        "Options",
        "As the slave",
        "Pace and part",
        "As the master",
    ]
