"""The commands of docs/table.md that answer five questions, with the output that it shows."""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from tests.golden.plant_capture import plant

if TYPE_CHECKING:
    from tests.cli.program import CommandLine

REPOSITORY = Path(__file__).resolve().parents[2]
PAGE = REPOSITORY / "docs" / "table.md"
CAPTURE = "captures/plant.pcap"
BEGINS, CUT = "    $ mbtool ", "..."


def questions() -> dict[str, list[str]]:
    """The command of each question, and the lines that it prints."""
    found: dict[str, list[str]] = {}
    lines: list[str] | None = None
    for line in PAGE.read_text().splitlines():
        if line.startswith(BEGINS) and CAPTURE in line:
            lines = found[line.removeprefix(BEGINS)] = []
        elif not line.startswith("    ") and line:
            lines = None
        elif lines is not None:
            lines.append(line.removeprefix("    "))
    return found


def test_there_are_five_questions() -> None:
    assert len(questions()) == 5


@pytest.mark.parametrize("command", questions())
def test_one_command_answers_the_question_as_the_page_shows(
    mbtool: CommandLine, monkeypatch: pytest.MonkeyPatch, command: str
) -> None:
    monkeypatch.chdir(REPOSITORY)
    shown = "\n".join(questions()[command]).rstrip()
    said = mbtool(*shlex.split(command))
    assert said.code == 0
    if shown.endswith(CUT):
        assert said.out.startswith(shown.removesuffix(CUT))
    else:
        assert [line.rstrip() for line in said.lines] == shown.splitlines()


def test_the_capture_of_the_questions_is_made_by_its_script() -> None:
    assert (REPOSITORY / CAPTURE).read_bytes() == plant()
