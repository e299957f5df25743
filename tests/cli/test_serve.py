"""Running a slave until someone stops it."""

from __future__ import annotations

import signal
from typing import Self

import pytest
import typer

from mbtool.cli import exit_codes
from mbtool.cli.serve import _SILENT_LOOKS, serve
from mbtool.core import LinkError
from mbtool.slave.shells import Shell


class _Shell(Shell):
    """A shell whose wait does what a test says."""

    def __init__(self, error: LinkError | None = None) -> None:
        super().__init__()
        self._error = error
        self.stopped = False

    @property
    def place(self) -> str:
        return "tcp:127.0.0.1:1502"

    def wait(self, timeout_s: float | None = None) -> None:
        if self._error is not None:
            raise self._error
        signal.raise_signal(signal.SIGINT)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.stopped = True

    def _open(self) -> None: ...

    def _run(self) -> None: ...

    def _interrupt(self) -> None: ...


def test_says_where_it_is_and_ends_with_ctrl_c(capsys: pytest.CaptureFixture[str]) -> None:
    shell = _Shell()
    with pytest.raises(typer.Exit) as end:
        serve(shell, "a device")
    assert end.value.exit_code == exit_codes.INTERRUPTED
    assert shell.stopped
    assert capsys.readouterr().err == "a device on tcp:127.0.0.1:1502; Ctrl-C ends\n"


def test_whoever_looks_on_looks_once_more_at_the_end() -> None:
    seen: list[bool] = []
    shell = _Shell()
    with pytest.raises(typer.Exit):
        serve(shell, "a device", lambda: seen.append(shell.stopped))
    assert seen == [False, True]


class _TellingShell(_Shell):
    def notes(self) -> list[str]:
        return ["remote reset"]


def test_what_the_devices_rules_did_is_told(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(typer.Exit):
        serve(_TellingShell(), "a device")
    assert capsys.readouterr().err.splitlines()[1:] == ["mbtool: remote reset"]


class _CrowdedShell(_Shell):
    """A shell that turns a connection away before each look of its first hundred."""

    def wait(self, timeout_s: float | None = None) -> None:
        self.turned_away += 1
        if self.turned_away > 2 * _SILENT_LOOKS:
            super().wait(timeout_s)


def test_says_once_in_a_while_that_connections_are_turned_away(
    capsys: pytest.CaptureFixture[str],
) -> None:
    with pytest.raises(typer.Exit):
        serve(_CrowdedShell(), "a device")
    _, *told = capsys.readouterr().err.splitlines()
    many = f"mbtool: {_SILENT_LOOKS} connections were turned away: the slave takes 1 at once"
    assert told == [
        many.replace(f"{_SILENT_LOOKS} connections were", "a connection was"),
        many,
        many,
    ]


def test_a_lost_link_ends_it() -> None:
    shell = _Shell(LinkError("lost"))
    with pytest.raises(LinkError, match="lost"):
        serve(shell, "a device")
    assert shell.stopped
