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
