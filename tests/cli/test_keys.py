"""The keys at a pseudo-terminal, and the line that shows where a player is."""

from __future__ import annotations

import io
import os
import sys
from contextlib import contextmanager
from fractions import Fraction
from typing import TYPE_CHECKING

import pytest

from mbtool.cli import keys
from mbtool.cli.keys import Keyboard, keyboard, progress_line
from mbtool.replay import Control, Progress

if TYPE_CHECKING:
    from collections.abc import Iterator

needs_terminals = pytest.mark.skipif(
    sys.platform == "win32", reason="pseudo-terminals need Linux or macOS"
)


class _Out(io.StringIO):
    """A standard error that says whether it is a terminal."""

    def __init__(self, is_terminal: bool = True) -> None:
        super().__init__()
        self._is_terminal = is_terminal

    def isatty(self) -> bool:
        return self._is_terminal


@contextmanager
def _terminal() -> Iterator[tuple[int, int]]:
    """Where a person types, and what a program reads."""
    near, far = os.openpty()
    try:
        yield near, far
    finally:
        os.close(near)
        os.close(far)


def _progress(**changes: object) -> Progress:
    given = {
        "position_ns": 12_340_000_000,
        "length_ns": 3_700_000_000_000,
        "lap": 0,
        "rate": Fraction(1),
        "is_paused": False,
        "is_waiting": False,
        "done": "7 asked",
    }
    return Progress(**{**given, **changes})  # type: ignore[arg-type]


@pytest.fixture
def always(monkeypatch: pytest.MonkeyPatch) -> None:
    """Looks and draws at every call."""
    monkeypatch.setattr(keys, "_LOOK_S", 0.0)
    monkeypatch.setattr(keys, "_DRAW_S", 0.0)


@needs_terminals
@pytest.mark.usefixtures("always")
@pytest.mark.parametrize(
    ("typed", "controls"),
    [
        (b" ", [Control.PAUSE]),
        (b"s\x1b[C\x1bOC", [Control.STEP] * 3),
        (b"+=\x1b[A\x1bOA", [Control.FASTER] * 4),
        (b"-\x1b[B\x1bOB", [Control.SLOWER] * 3),
        (b"x\x1b[D\xff\n", []),
        (b" +s", [Control.PAUSE, Control.FASTER, Control.STEP]),
    ],
)
def test_keys_are_what_rosbags_player_has(typed: bytes, controls: list[Control]) -> None:
    import tty

    with _terminal() as (near, far):
        tty.setraw(far)
        board = Keyboard(far, _Out())
        os.write(near, typed)
        assert list(board.controls()) == controls
        assert not board.has_quit
        assert list(board.controls()) == []
        os.write(near, b"q")
        assert list(board.controls()) == []
        assert board.has_quit


@pytest.mark.usefixtures("always")
def test_an_input_that_has_ended_is_not_asked_again() -> None:
    reading, writing = os.pipe()
    os.close(writing)
    board = Keyboard(reading, _Out())
    assert list(board.controls()) == []
    os.close(reading)
    assert list(board.controls()) == []


def test_keys_are_looked_for_now_and_then() -> None:
    reading, writing = os.pipe()
    try:
        board = Keyboard(reading, _Out())
        assert list(board.controls()) == []
        os.write(writing, b" ")
        assert list(board.controls()) == []  # Too soon to look again.
    finally:
        os.close(reading)
        os.close(writing)


@pytest.mark.usefixtures("always")
def test_one_line_is_drawn_over_and_taken_away(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "30")
    out = _Out()
    board = Keyboard(0, out)
    board.wipe()
    assert out.getvalue() == ""
    board.show(_progress())
    assert out.getvalue() == "\r\x1b[Kplaying  0:12.3 of 1:01:40.0 "
    board.wipe()
    board.wipe()
    assert out.getvalue().count("\x1b[K") == 2


@pytest.mark.usefixtures("always")
def test_no_line_is_drawn_into_a_file() -> None:
    out = _Out(is_terminal=False)
    Keyboard(0, out).show(_progress())
    assert out.getvalue() == ""


@pytest.mark.parametrize(
    ("changes", "begins"),
    [
        ({}, "playing  0:12.3 of 1:01:40.0  x1  7 asked   space pauses"),
        ({"is_paused": True}, "paused   0:12.3 of"),
        ({"is_waiting": True}, "waiting  0:12.3 of"),
        ({"lap": 1, "rate": Fraction(1, 4)}, "playing  0:12.3 of 1:01:40.0, round 2  x0.25"),
        ({"rate": None}, "playing, as fast as can be; 7 asked"),
    ],
)
def test_the_line_says_where_it_is(changes: dict[str, object], begins: str) -> None:
    assert progress_line(_progress(**changes), 150).startswith(begins)


def test_the_line_fits_80_columns() -> None:
    usual = progress_line(_progress(), 79)
    assert usual == "playing  0:12.3 of 1:01:40.0  x1  7 asked   keys: space s + - q"
    done = "12,345 asked, 11,111 as recorded"
    long = progress_line(_progress(position_ns=3_700 * 10**9, rate=Fraction(1, 64), done=done), 79)
    assert long == f"playing  1:01:40.0 of 1:01:40.0  x0.0156  {done}"
    assert len(long) <= 79


def test_without_a_terminal_there_are_no_keys(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sys.stdin", io.StringIO())
    with keyboard() as board:
        assert board is None


@needs_terminals
def test_a_terminal_of_others_is_left_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    """One that this program is not in the foreground of would stop it."""
    import termios

    with _terminal() as (_, far), os.fdopen(os.dup(far)) as stdin:
        before = termios.tcgetattr(far)
        monkeypatch.setattr("sys.stdin", stdin)
        with keyboard() as board:
            assert board is None
            assert termios.tcgetattr(far) == before


@needs_terminals
def test_the_terminal_is_as_it_was_afterwards(monkeypatch: pytest.MonkeyPatch) -> None:
    import termios

    with _terminal() as (_, far):
        monkeypatch.setattr(keys, "_terminal", lambda: far)
        before = termios.tcgetattr(far)
        with keyboard() as board:
            assert board is not None
            assert not termios.tcgetattr(far)[3] & (termios.ECHO | termios.ICANON)
            assert termios.tcgetattr(far)[3] & termios.ISIG
        assert termios.tcgetattr(far) == before
