"""The console that tables are printed on."""

from __future__ import annotations

import io
from typing import NoReturn

import pytest

from mbtool.cli.console import PipeConsole


class _Broken(io.StringIO):
    def write(self, text: str, /) -> NoReturn:
        raise BrokenPipeError


def test_a_broken_pipe_is_left_to_the_command_line() -> None:
    with pytest.raises(BrokenPipeError):
        PipeConsole(file=_Broken()).print("text")


def test_a_dumb_terminal_has_its_own_width(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TERM", "dumb")
    monkeypatch.setenv("COLUMNS", "60")
    monkeypatch.setenv("LINES", "24")
    console = PipeConsole(file=io.StringIO(), force_terminal=True, _environ={"TERM": "dumb"})
    assert (console.width, console.height) == (60, 24)
    assert PipeConsole(file=io.StringIO(), width=70).width == 70
