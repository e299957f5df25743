"""What every shell does, whatever its link."""

from __future__ import annotations

import threading

import pytest

from mbtool.core import LinkError
from mbtool.slave.shells.shell import Shell
from tests.slave.scripted import PATIENCE_S


class _Fake(Shell):
    """Runs until it is interrupted, or loses its link."""

    def __init__(self, *, refused: bool = False, lost: bool = False) -> None:
        super().__init__()
        self._refused = refused
        self._lost = lost
        self._interrupted = threading.Event()
        self.runs = 0

    @property
    def place(self) -> str:
        return "nowhere"

    def _open(self) -> None:
        if self._refused:
            raise LinkError("refused")

    def _run(self) -> None:
        if self._lost:
            raise LinkError("lost")
        assert self._interrupted.wait(PATIENCE_S)
        self.runs += 1

    def _interrupt(self) -> None:
        self._interrupted.set()


def test_runs_between_start_and_stop() -> None:
    with _Fake() as shell:
        shell.wait(0)
        assert shell.runs == 0
    assert shell.runs == 1
    shell.wait()


def test_what_keeps_it_from_opening_is_raised_by_start() -> None:
    shell = _Fake(refused=True)
    with pytest.raises(LinkError, match="refused"):
        shell.start()
    shell.stop()


def test_a_lost_link_is_raised_by_wait() -> None:
    shell = _Fake(lost=True)
    shell.start()
    with pytest.raises(LinkError, match="lost"):
        shell.wait(PATIENCE_S)
    shell.stop()


def test_is_started_once() -> None:
    with _Fake() as shell, pytest.raises(RuntimeError, match="started once"):
        shell.start()


def test_stopping_what_has_just_ended_is_no_error() -> None:
    class Ending(_Fake):
        def _interrupt(self) -> None:
            super()._interrupt()
            raise RuntimeError("Event loop is closed")

    with Ending() as shell:
        shell.wait(0)
    assert shell.runs == 1
