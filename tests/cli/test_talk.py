"""Signals that are wishes."""

from __future__ import annotations

import os
import signal
import sys
import threading
from contextlib import redirect_stderr
from typing import TYPE_CHECKING

import pytest

from mbtool.cli.talk import (
    Interrupt,
    interruptible,
    never_waiting,
    redrawn_line,
    say,
    say_if_interrupted,
    shown_progress,
)
from tests.cli.program import PATIENCE_S, full_terminal

if TYPE_CHECKING:
    from collections.abc import Iterator
    from types import FrameType

    from _typeshed import TraceFunction


@pytest.mark.skipif(sys.platform == "win32", reason="no pseudo-terminals on Windows")
@pytest.mark.parametrize(
    ("number", "shown"), [(signal.SIGINT, b"\r\nend"), (signal.SIGTERM, b"end")]
)
def test_what_is_said_after_ctrl_c_begins_in_a_new_line_of_the_terminal(
    monkeypatch: pytest.MonkeyPatch, number: int, shown: bytes
) -> None:
    ours, theirs = os.openpty()
    with open(theirs, "w", encoding="utf-8") as terminal:
        monkeypatch.setattr(sys, "stderr", terminal)
        Interrupt().ask(number, None)
        say("end")
        got = b""
        while not got.endswith(b"end\r\n"):
            got += os.read(ours, 100)
    os.close(ours)
    assert got == shown + b"\r\n"


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_the_first_signal_is_a_wish_and_the_second_ends_at_once(number: int) -> None:
    before = signal.getsignal(number)
    with interruptible() as interrupt:
        assert not interrupt.wait(0)
        signal.raise_signal(number)
        assert interrupt.wait(0)
        assert interrupt.asked
        with pytest.raises(KeyboardInterrupt):
            signal.raise_signal(number)
    assert signal.getsignal(number) is before


def _signalled() -> Iterator[str]:
    """A wait for input into which Ctrl-C comes."""
    yield "one"
    signal.raise_signal(signal.SIGINT)
    yield "two"


def test_a_wait_for_the_next_item_is_broken_off() -> None:
    got: list[str] = []
    with interruptible() as interrupt, pytest.raises(KeyboardInterrupt):
        got.extend(interrupt.breakable(_signalled()))
    assert got == ["one"]


def test_what_is_done_with_an_item_is_not_broken_off() -> None:
    done = []

    def work(interrupt: Interrupt) -> None:
        for item in interrupt.breakable(iter("abc")):
            signal.raise_signal(signal.SIGINT)
            done.append(item)

    with interruptible() as interrupt, pytest.raises(KeyboardInterrupt):
        work(interrupt)
    assert done == ["a"]


def test_without_a_signal_all_items_come() -> None:
    with interruptible() as interrupt:
        assert list(interrupt.breakable(iter("abc"))) == list("abc")


def test_a_redrawn_line_is_erased_before_something_is_said(
    capsys: pytest.CaptureFixture[str],
) -> None:
    wiped: list[str] = []
    with redrawn_line(lambda: wiped.append(capsys.readouterr().err)):
        say("one")
        say("two")
    say("three")
    assert wiped == ["", "one\n"]
    assert capsys.readouterr().err == "two\nthree\n"


@pytest.mark.skipif(sys.platform == "win32", reason="no pseudo-terminals on Windows")
def test_a_long_message_does_not_wait_for_a_terminal_that_takes_only_a_part_of_it() -> None:
    with full_terminal() as full, open(full, "w", closefd=False) as file, redirect_stderr(file):
        with never_waiting():
            say("x" * 10_000)
        assert sys.stderr is file


def _waits_with_a_signal_at(line: int) -> bool:
    """True if the signal came before the wait was over."""
    interrupt, lines = Interrupt(), iter(range(line, -1, -1))

    def trace(_frame: FrameType, event: str, _argument: object) -> TraceFunction:
        if event == "line" and next(lines, None) == 0:
            interrupt.ask(signal.SIGINT, None)
        return trace

    def wait() -> None:
        sys.settrace(trace)
        interrupt.wait(0.001)

    waiting = threading.Thread(target=wait, daemon=True)
    waiting.start()
    waiting.join(PATIENCE_S)
    assert not waiting.is_alive(), f"a signal at line {line} of a wait stops the program for good"
    return interrupt.asked


def test_a_signal_at_any_line_of_a_wait_does_not_deadlock() -> None:
    line = 0
    while _waits_with_a_signal_at(line):
        line += 1
    assert line > 0


def test_an_interruption_says_what_was_kept(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(KeyboardInterrupt), say_if_interrupted("interrupted; nothing was written"):
        raise KeyboardInterrupt
    assert capsys.readouterr().err == "interrupted; nothing was written\n"
    with say_if_interrupted():
        pass
    assert capsys.readouterr().err == ""


def test_progress_is_one_line_of_a_terminal_that_is_erased_at_the_end(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("sys.stderr.isatty", lambda: True)
    with shown_progress() as show:
        show("unit 1")
        say("found")
        show("unit\n2")
    erase = "\r\x1b[K"
    assert capsys.readouterr().err == f"unit 1{erase}found\nunit\\n2{erase}"


def test_progress_is_said_now_and_then_where_there_is_no_terminal(
    capsys: pytest.CaptureFixture[str],
) -> None:
    for least_s, told in ((None, ""), (0.0, "unit 1\nunit 2\n"), (3600.0, "")):
        with shown_progress(least_s) as show:
            show("unit 1")
            show("unit 2")
        assert capsys.readouterr().err == told
