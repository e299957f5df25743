"""What `watch` says before there is a screen. The screen itself is tested in tests/cli/watching."""

from __future__ import annotations

import builtins
import os
import sys
import termios
import tty
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

from mbtool.cli import exit_codes
from mbtool.cli.watch import restored_terminal

if TYPE_CHECKING:
    from collections.abc import Iterator

    from tests.cli.program import CommandLine

LOG = Path(__file__).resolve().parents[2] / "captures" / "ft1a-touch-line.mcap"
LINK = "rtu:/dev/absent@19200-8E1"


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ([LOG], "watch needs a terminal; into a pipe or file, use sniff, decode or stats"),
        ([LOG, LINK], "name files or links, not both"),
        ([LINK, "--raw"], "--raw, --link and --play go with files"),
        ([LINK, "--play"], "--raw, --link and --play go with files"),
        ([LOG, "-w", "x.mcap"], "--write, --overwrite and --allow go with a link"),
        ([LOG, "--where", "foo == 1"], "there is no 'foo'"),
    ],
)
def test_a_wrong_call_is_one_line(mbtool: CommandLine, arguments: list[object], said: str) -> None:
    told = mbtool("watch", *arguments)
    assert told.code == exit_codes.USAGE
    assert said in told.err
    assert told.err.count("\n") == 1


def test_without_textual_a_line_says_how_to_get_it(
    mbtool: CommandLine, monkeypatch: pytest.MonkeyPatch
) -> None:
    original = builtins.__import__

    def without(name: str, *rest: Any, **options: Any) -> Any:
        if name == "textual":
            raise ImportError(name)
        return original(name, *rest, **options)

    monkeypatch.setattr(builtins, "__import__", without)
    told = mbtool("watch", LOG)
    assert told.code == exit_codes.USAGE
    assert told.err.startswith("mbtool: watch needs the extra mbtool[watch]: ")
    assert len(told.err.splitlines()) == 1


@contextmanager
def pseudo_terminal(monkeypatch: pytest.MonkeyPatch) -> Iterator[tuple[int, int]]:
    """Standard input and output are a terminal; gives the descriptors of its two ends."""
    ours, theirs = os.openpty()
    os.set_blocking(ours, False)
    with open(theirs, closefd=False) as stdin, open(theirs, "w", closefd=False) as stdout:
        monkeypatch.setattr(sys, "stdin", stdin)
        monkeypatch.setattr(sys, "stdout", stdout)
        yield ours, theirs
        monkeypatch.undo()
    os.close(ours)
    os.close(theirs)


def test_a_terminal_is_given_back_as_it_was_after_any_error(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def fail(terminal: int) -> None:
        with restored_terminal():
            tty.setraw(terminal)
            raise RuntimeError

    with pseudo_terminal(monkeypatch) as (ours, theirs):
        before = termios.tcgetattr(theirs)
        with pytest.raises(RuntimeError):
            fail(theirs)
        assert termios.tcgetattr(theirs) == before
        said = os.read(ours, 1000)
    assert b"\x1b[?1049l" in said  # The first screen is back.
    assert b"\x1b[?25h" in said  # The cursor is shown.


def test_nothing_is_written_to_a_terminal_when_all_is_well(monkeypatch: pytest.MonkeyPatch) -> None:
    with pseudo_terminal(monkeypatch) as (ours, _):
        with restored_terminal():
            pass
        with pytest.raises(BlockingIOError):
            os.read(ours, 1000)


@pytest.mark.parametrize(
    ("stdin", "cause"),
    [(None, "which is closed"), (os.devnull, "which is no terminal")],
)
def test_a_standard_input_without_keys_is_told_as_the_cause(
    mbtool: CommandLine, monkeypatch: pytest.MonkeyPatch, stdin: str | None, cause: str
) -> None:
    with pseudo_terminal(monkeypatch), ExitStack() as opened:
        file = None if stdin is None else opened.enter_context(open(stdin))
        monkeypatch.setattr(sys, "stdin", file)
        told = mbtool("watch", LOG)
    assert told.code == exit_codes.USAGE
    assert told.err == (
        f"mbtool: watch takes its keys from standard input, {cause}: let that be the terminal, "
        "or use sniff, decode or stats\n"
    )
