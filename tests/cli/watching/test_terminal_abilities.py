"""Which terminals the full screen is drawn on, and on which without colours."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

from mbtool.cli.watching import terminal_output
from mbtool.cli.watching.terminal_output import TerminalAbilities, prepare_terminal
from mbtool.core import UsageError


@pytest.fixture(autouse=True)
def terminal(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TERM", "a-terminal")


def given(monkeypatch: pytest.MonkeyPatch, abilities: TerminalAbilities) -> None:
    monkeypatch.setattr(terminal_output, "terminal_abilities", lambda: abilities)


@pytest.mark.parametrize(
    ("term", "abilities"),
    [("dumb", (False, False)), ("vt100", (True, False)), ("xterm", (True, True)),
     ("no-such-terminal", (True, True))],
)  # fmt: skip
def test_terminfo_says_what_a_terminal_can_do(term: str, abilities: tuple[bool, bool]) -> None:
    pytest.importorskip("curses")
    program = (
        "from mbtool.cli.watching.terminal_output import terminal_abilities\n"
        "print(tuple(terminal_abilities()))"
    )
    ran = subprocess.run(
        [sys.executable, "-c", program],
        env={**os.environ, "TERM": term},
        capture_output=True,
        text=True,
        check=True,
    )
    assert ran.stdout.strip() == str(abilities)


def test_a_terminal_without_cursor_is_refused_with_what_to_use(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    given(monkeypatch, TerminalAbilities(has_cursor=False, has_colours=False))
    with pytest.raises(UsageError, match=r"TERM=a-terminal cannot: use sniff, decode or stats"):
        prepare_terminal()


@pytest.mark.parametrize(
    ("asked", "has_colours", "told"),
    [(None, True, None), (None, False, "1"), ("", True, None), ("yes", True, "yes")],
)
def test_no_color_is_set_just_where_no_colours_are_shown(
    monkeypatch: pytest.MonkeyPatch, asked: str | None, has_colours: bool, told: str | None
) -> None:
    given(monkeypatch, TerminalAbilities(has_colours=has_colours))
    # delenv after setenv, so that the fixture takes away what the call sets.
    monkeypatch.setenv("NO_COLOR", asked or "")
    if asked is None:
        monkeypatch.delenv("NO_COLOR")
    prepare_terminal()
    assert os.environ.get("NO_COLOR") == told
