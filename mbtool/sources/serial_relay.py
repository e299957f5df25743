"""The process of a serial tap: python -m mbtool.sources.serial_relay MASTER SLAVES FORMAT."""

# The line is cut, and each end has a port. What one port hears the other says: at once, as read, in
# the order wait, read, take the time, pass on, hand over. So the record of a request always stands
# before that of its response. Records are those of serial_reader.py, which a tap's process is but
# for this; ANSWER is what the slaves' side brought.
#
# A port is not read while what it brought last is not yet with the other's driver. So at most one
# read waits in each direction, and where a side stands still, the system's own buffer is what holds
# and then loses, which its counters tell. A silence is not told meanwhile, as nobody knows of one.
#
# What was recorded was passed on: when told to end, and when one side is lost, both are read a last
# time, and what is still to be sent gets LAST_S to go out.
#
# What goes on is the byte: the wrong parity of a damaged one is not made again, and a break goes on
# as 00. Both are told as `line-error`.

from __future__ import annotations

import gc
import os
import select
import signal
import sys
import time
from contextlib import ExitStack, suppress
from threading import Event, Thread
from typing import TYPE_CHECKING, Protocol

from mbtool.core import LinkError, SerialFormat
from mbtool.ports.clock import now_ns
from mbtool.ports.line_errors import ErrorCounts, LineErrors, LineTrouble
from mbtool.ports.serial_port import IDLE_S, explain
from mbtool.ports.serial_records import RecordKind, RecordWriter
from mbtool.sources.priority import run_promptly

if TYPE_CHECKING:
    from collections.abc import Sequence

LAST_S = 0.5


class Port(Protocol):
    """What the relay needs of a port. Reading and writing raise LinkError when it is gone."""

    damaged: Sequence[int]

    def fileno(self) -> int: ...
    def read(self, wait_s: float) -> bytes: ...
    def write(self, data: bytes) -> int: ...
    def counts(self) -> ErrorCounts | None: ...
    def close(self) -> None: ...


def main() -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    run_promptly()
    gc.disable()  # The loop makes no cycles, and a collection would delay what is passed on.
    master, slaves, settings = sys.argv[1:]
    with suppress(BrokenPipeError):
        _join_ports((master, slaves), SerialFormat.parse(settings), sys.stdout.fileno())


def _join_ports(names: tuple[str, str], format_: SerialFormat, pipe: int) -> None:
    told_to_end = Event()
    Thread(target=_await_end, args=(told_to_end,), daemon=True).start()
    records = RecordWriter(pipe)
    error = ""
    try:
        with ExitStack() as opened:
            ports = []
            for name in names:
                ports.append(_open_passing(name, format_))
                opened.callback(ports[-1].close)
            records.put(RecordKind.QUIET, now_ns())
            SerialRelay(ports[0], ports[1], records, format_).run_until(told_to_end)
    except LinkError as link_error:
        error = str(link_error)
    records.end(now_ns(), error)


class SerialRelay:
    """Passes on between two ports and records both."""

    def __init__(
        self, master: Port, slaves: Port, records: RecordWriter, format_: SerialFormat
    ) -> None:
        self._records = records
        self._settle_s = min(2 * format_.t3_5_ns / 1e9, IDLE_S)
        self._sides = (
            _SerialDirection(master, RecordKind.DATA, "the master's side", format_),
            _SerialDirection(slaves, RecordKind.ANSWER, "the slaves' side", format_),
        )
        self._sides[0].onward, self._sides[1].onward = slaves, master

    def run_until(self, told_to_end: Event) -> None:
        """Pass on until told to end, and what has arrived by then.

        Raises LinkError when a port is lost and BrokenPipeError when the parent is.
        """
        try:
            wait_s = IDLE_S
            while not told_to_end.is_set():
                wait_s = self._turn(wait_s)
        finally:
            self._finish()

    def _turn(self, wait_s: float) -> float:
        """Wait once and do what there is to do; how long to wait next."""
        asked_ns = now_ns()
        waiting = [side for side in self._sides if side.unsent]
        able = [side for side in self._sides if not side.unsent]
        heard, _, _ = select.select(
            [side.port for side in able],
            [side.onward for side in waiting],
            [],
            min(wait_s, IDLE_S),
        )
        for side in waiting:
            side.send()
        has_heard = [side.take(self._records) for side in able if side.port in heard]
        for side in self._sides:
            side.tell(self._records, now_ns())
        if any(has_heard):
            return self._settle_s
        if waiting:
            return IDLE_S
        if wait_s:
            return 0.0
        self._records.put(RecordKind.QUIET, asked_ns)
        return IDLE_S

    def _finish(self) -> None:
        for side in self._sides:
            with suppress(LinkError):
                side.finish(self._records)
            side.tell_all(self._records)


class _SerialDirection:
    """One direction: the port that brings it, and where it goes."""

    onward: Port

    def __init__(self, port: Port, kind: RecordKind, name: str, format_: SerialFormat) -> None:
        self.port = port
        self.unsent = b""
        """What the other port's driver had no room for."""
        self._kind = kind
        self._name = name
        self._errors = LineErrors(port.counts, format_.character_ns, now_ns())

    def take(self, records: RecordWriter) -> bool:
        """Read, pass on, record; False where nothing has come after all."""
        data = self.port.read(0)
        read_ns = now_ns()
        if not data:
            return False
        self.unsent = data
        try:
            self.send()
        finally:  # It was heard, wherever it could go.
            records.put(self._kind, read_ns, data)
            if self.port.damaged:
                self._errors.mark(data, self.port.damaged, read_ns)
        return True

    def send(self) -> None:
        self.unsent = self.unsent[self.onward.write(self.unsent) :]

    def finish(self, records: RecordWriter) -> None:
        """Pass on what waits and what has arrived, for LAST_S at most."""
        self._send_rest()
        if not self.unsent:
            self.take(records)
            self._send_rest()

    def _send_rest(self) -> None:
        end_s = time.monotonic() + LAST_S
        while self.unsent and (left_s := end_s - time.monotonic()) > 0:
            select.select([], [self.onward], [], left_s)
            self.send()

    def tell(self, records: RecordWriter, at_ns: int) -> None:
        """Hand over what the driver tells of damage."""
        for trouble in self._errors.tell(at_ns):
            _put_trouble(records, trouble, self._name)

    def tell_all(self, records: RecordWriter) -> None:
        for trouble in self._errors.tell_all(now_ns()):
            _put_trouble(records, trouble, self._name)


def _put_trouble(records: RecordWriter, trouble: LineTrouble, side: str) -> None:
    if trouble.lost:
        records.put_count(RecordKind.OVERRUN, trouble.ts_ns, trouble.lost)
    else:
        records.put(RecordKind.DAMAGE, trouble.ts_ns, f"on {side}: {trouble.text}".encode())


def _open_passing(name: str, format_: SerialFormat) -> Port:
    if sys.platform == "win32":
        raise LinkError("a serial tap needs Linux or macOS")
    from mbtool.ports.posix_serial import PassingPort

    try:
        return PassingPort(name, format_)
    except (OSError, ValueError, OverflowError) as error:
        raise explain(name, format_, error) from error


def _await_end(told_to_end: Event) -> None:
    while os.read(sys.stdin.fileno(), 1):
        pass
    told_to_end.set()


if __name__ == "__main__":
    main()
