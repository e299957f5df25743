"""A recording played onto a line."""

from __future__ import annotations

import os
import select
import sys
import tty
from contextlib import contextmanager
from fractions import Fraction
from typing import TYPE_CHECKING

import pytest

from mbtool.core import LinkError, SerialFormat, SerialLink, UsageError, parse_link
from mbtool.modbus import rtu_adu
from mbtool.replay import Control
from mbtool.workflows.replay_bus import BusOptions, BusRun, line_link
from tests.workflows.evidence import READ, VALUES, capture_file

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence
    from pathlib import Path

    from mbtool.replay import Progress

pytestmark = pytest.mark.skipif(
    sys.platform == "win32", reason="pseudo-terminals need Linux or macOS"
)

FAST = SerialFormat(115200, 8, "N", 1)
PATIENCE_S = 120.0
WHOLE = (rtu_adu(1, READ) + rtu_adu(1, VALUES)) * 3


@pytest.fixture
def capture(tmp_path: Path) -> Path:
    path = tmp_path / "a.pcap"
    path.write_bytes(capture_file(3))
    return path


@contextmanager
def _line() -> Iterator[tuple[SerialLink, int]]:
    """A port to play on, and the descriptor that hears it."""
    near, far = os.openpty()
    tty.setraw(far)
    try:
        yield SerialLink(os.ttyname(far), FAST), near
    finally:
        os.close(near)
        os.close(far)


def _heard(near: int, count: int) -> bytes:
    data = b""
    while len(data) < count:
        assert select.select([near], [], [], PATIENCE_S)[0], f"only {data.hex(' ')}"
        data += os.read(near, 4096)
    return data


def test_every_byte_is_heard_and_counted(capture: Path) -> None:
    with _line() as (link, near):
        report = BusRun(str(capture), BusOptions(rate=Fraction(64)), link).play()
        assert _heard(near, len(WHOLE)) == WHOLE
    assert (report.bytes, report.pieces) == (len(WHOLE), 6)


def test_at_full_speed_no_lateness_is_reported(capture: Path) -> None:
    with _line() as (link, near):
        report = BusRun(str(capture), BusOptions(rate=None), link).play()
        assert _heard(near, len(WHOLE)) == WHOLE
    assert (report.held, report.lateness_p99_ns) == (0, None)


def test_it_ends_when_it_is_told_to(capture: Path) -> None:
    with _line() as (link, _):
        report = BusRun(str(capture), BusOptions(), link).play(stops=lambda: True)
    assert (report.bytes, report.lateness_p99_ns) == (0, None)


class _Controls:
    """Someone who pauses at once, steps twice, and goes on as fast as he can."""

    def __init__(self) -> None:
        self._wanted = [Control.PAUSE, Control.STEP, Control.STEP]
        self.shown: list[Progress] = []

    def controls(self) -> Sequence[Control]:
        if self._wanted:
            return [self._wanted.pop(0)]
        if self.shown and self.shown[-1].done == "17 bytes" and self.shown[-1].is_paused:
            return [Control.PAUSE, *[Control.FASTER] * 6]
        return []

    def show(self, progress: Progress) -> None:
        self.shown.append(progress)


def test_it_is_paused_and_stepped_from_the_keyboard(capture: Path) -> None:
    controls = _Controls()
    with _line() as (link, near):
        BusRun(str(capture), BusOptions(), link).play(controls=controls)
        assert _heard(near, len(WHOLE)) == WHOLE
    assert any(one.is_paused for one in controls.shown)
    assert controls.shown[-1].rate == 64


def test_a_loop_goes_on_until_it_is_stopped(capture: Path) -> None:
    with _line() as (link, near):
        heard = bytearray()

        def stops() -> bool:
            while select.select([near], [], [], 0)[0]:
                heard.extend(os.read(near, 4096))
            return len(heard) > len(WHOLE)

        report = BusRun(str(capture), BusOptions(rate=Fraction(64), is_loop=True), link).play(
            stops=stops
        )
    assert heard.startswith(WHOLE)
    assert report.pieces > 6


def test_a_window_has_the_length_that_was_asked_for(capture: Path) -> None:
    from mbtool.replay import TimeRange

    with _line() as (link, _):
        run = BusRun(str(capture), BusOptions(window=TimeRange(0, 5_000_000_000)), link)
        assert run.length_ns == 5_000_000_000


def test_a_bus_is_a_serial_line() -> None:
    link = parse_link("ascii:/dev/x@9600-7E1")
    assert line_link(link) is link
    with pytest.raises(UsageError, match="a bus is a serial line: rtu:PORT"):
        line_link(parse_link("tcp:127.0.0.1:1502"))
    with pytest.raises(UsageError, match="two ports can only listen"):
        line_link(parse_link("rtu:/dev/x,/dev/y@9600"))


def test_a_port_that_is_not_there_is_named(capture: Path) -> None:
    run = BusRun(str(capture), BusOptions(), SerialLink("/dev/absent", FAST))
    with pytest.raises(LinkError, match="/dev/absent: is not there"):
        run.play()
