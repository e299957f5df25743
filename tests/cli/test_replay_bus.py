"""mbtool replay --as-bus."""

from __future__ import annotations

import os
import select
import signal
import sys
import tty
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from mbtool.cli import exit_codes
from mbtool.modbus import rtu_adu
from tests.cli.program import PATIENCE_S, CommandLine, Program
from tests.workflows.evidence import READ, VALUES

if TYPE_CHECKING:
    from collections.abc import Iterator

pytestmark = pytest.mark.skipif(
    sys.platform == "win32", reason="pseudo-terminals need Linux or macOS"
)

OURS = Path(__file__).resolve().parents[2] / "captures"


@contextmanager
def _port() -> Iterator[tuple[str, int]]:
    near, far = os.openpty()
    tty.setraw(far)
    try:
        yield os.ttyname(far), near
    finally:
        os.close(near)
        os.close(far)


def _read(near: int, size: int) -> bytes:
    """The next bytes: a pseudo-terminal hands them on a little later, and not always at once."""
    data = b""
    while len(data) < size and select.select([near], [], [], PATIENCE_S)[0]:
        data += os.read(near, size - len(data))
    return data


def test_every_byte_is_sent_and_how_true_the_times_were_is_told(
    mbtool: CommandLine, capture: Path
) -> None:
    sent = (rtu_adu(1, READ) + rtu_adu(1, VALUES)) * 3
    with _port() as (port, near):
        told = mbtool("replay", capture, "--as-bus", "--on", f"rtu:{port}@115200-8N1")
        heard = _read(near, len(sent))
    assert (told.code, told.out) == (exit_codes.DONE, "")
    assert heard == sent
    first, last = told.err.splitlines()
    assert first.startswith(f"{capture}: 51 bytes on rtu:{port}@115200-8N1, ")
    assert first.endswith(" s; Ctrl-C ends")
    assert last.startswith("51 bytes in 6 pieces; ")


def test_it_ends_with_ctrl_c() -> None:
    arguments = ["--as-bus", "--loop", "--speed", "0.01"]
    with _port() as (port, near):
        on = f"rtu:{port}@19200-8E1"
        path = OURS / "torn-and-glued-frames.mcap"
        with Program("replay", path, *arguments, "--on", on) as program:
            assert ", again and again; Ctrl-C ends" in program.await_said("Ctrl-C ends")
            assert os.read(near, 1)
            told = program.end(signal.SIGINT)
    assert told.code == exit_codes.INTERRUPTED
    assert " pieces" in told.err


def test_a_bus_needs_a_serial_line(mbtool: CommandLine, capture: Path) -> None:
    told = mbtool("replay", capture, "--as-bus", "--on", "tcp:127.0.0.1:1502")
    assert told.code == exit_codes.USAGE
    assert "a bus is a serial line: rtu:PORT@19200-8E1 or ascii:PORT@9600-7E1" in told.err


def test_a_line_that_is_not_there_is_the_only_message(mbtool: CommandLine, capture: Path) -> None:
    told = mbtool("replay", capture, "--as-bus", "--on", "rtu:/dev/absent@19200-8E1")
    assert told.code == exit_codes.UNREADABLE
    (line,) = told.err.splitlines()
    assert "/dev/absent" in line
