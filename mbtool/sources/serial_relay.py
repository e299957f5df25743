"""The process of a serial tap: mbtool.sources.serial_relay MASTER SLAVES FORMAT DTR,RTS."""

# The line is cut in two, and each end is connected to a port. The process waits, reads, notes the
# time, sends the bytes to the other port at once, and records them. So the record of a request
# always comes before the record of its response. The records are those of serial_reader.py; bytes
# from the slaves' side have the kind ANSWER.
#
# A port is not read while bytes of its last read still wait for room in the other port's driver. So
# at most one read waits in each direction. If the other port takes no bytes, the system's buffer of
# this port fills and then loses bytes, which the driver counts. No silence is reported in that
# time, as bytes may be arriving at the port that is not read.
#
# All recorded bytes are also passed on: when the process is told to end, or one port is gone, both
# ports are read a last time, and pending bytes are sent, for at most LAST_S.
#
# Damaged bytes are passed on undamaged: a byte with wrong parity is sent with correct parity, and a
# break is sent as 00. Both are reported as `line-error`.

from __future__ import annotations

import select
import sys
import time
from collections.abc import Sequence
from contextlib import closing, suppress
from functools import partial
from typing import TYPE_CHECKING, Protocol

from mbtool.core import LinkError, SerialFormat
from mbtool.core.serial_format import ModemLines
from mbtool.ports.clock import now_ns
from mbtool.ports.line_errors import ErrorCounts, LineErrors
from mbtool.ports.serial_opening import open_passing
from mbtool.ports.serial_port import IDLE_S
from mbtool.ports.serial_records import RecordKind, RecordWriter
from mbtool.sources.serial_process import put_troubles, run_process

if TYPE_CHECKING:
    from threading import Event

LAST_S = 0.5
"""At the end of the run, unsent bytes of each direction are sent for at most this many seconds."""


class Port(Protocol):
    """The methods of a port that a serial tap uses.

    `read` and `write` raise LinkError if the port is gone.
    """

    damaged: Sequence[int]

    def fileno(self) -> int: ...
    def read(self, wait_s: float) -> bytes: ...
    def write(self, data: bytes) -> int: ...
    def counts(self) -> ErrorCounts | None: ...
    def close(self) -> None: ...


def main() -> None:
    master, slaves, settings, lines = sys.argv[1:]
    format_, modem_lines = SerialFormat.parse(settings), ModemLines.parse(lines)
    run_process(partial(_join_ports, (master, slaves), format_, modem_lines))


def _join_ports(
    names: tuple[str, str],
    format_: SerialFormat,
    modem_lines: ModemLines,
    records: RecordWriter,
    told_to_end: Event,
) -> None:
    with (
        closing(open_passing(names[0], format_, modem_lines)) as master,
        closing(open_passing(names[1], format_, modem_lines)) as slaves,
    ):
        records.put(RecordKind.QUIET, now_ns())
        SerialRelay(master, slaves, records, format_).run_until(told_to_end)


class SerialRelay:
    """Passes bytes between the two ports of a serial tap, and records both directions."""

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
        """Pass on and record all bytes that arrive until `told_to_end` is set.

        Raises LinkError when a port is gone, and BrokenPipeError when the parent process has ended.
        """
        try:
            wait_s = IDLE_S
            while not told_to_end.is_set():
                wait_s = self._wait_and_pass(wait_s)
        finally:
            self._finish()

    def _wait_and_pass(self, wait_s: float) -> float:
        """Wait at most `wait_s` seconds for bytes at both ports, pass them on and record them.

        Returns the `wait_s` for the next call.
        """
        asked_ns = now_ns()
        waiting = [side for side in self._sides if side.unsent]
        readable = [side for side in self._sides if not side.unsent]
        heard, _, _ = select.select(
            [side.port for side in readable],
            [side.onward for side in waiting],
            [],
            min(wait_s, IDLE_S),
        )
        for side in waiting:
            side.send()
        has_heard = [side.take(self._records) for side in readable if side.port in heard]
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
    """One direction of a serial tap: the port that is read, and the port that gets the bytes."""

    onward: Port

    def __init__(self, port: Port, kind: RecordKind, name: str, format_: SerialFormat) -> None:
        self.port = port
        self.unsent = b""
        """Bytes that were read and not yet sent, as the other port's driver had no room for
        them."""
        self._kind = kind
        self._prefix = f"on {name}: "
        self._errors = LineErrors(port.counts, format_.character_ns, now_ns())

    def take(self, records: RecordWriter) -> bool:
        """Read the port without waiting, pass the bytes on and record them.

        Returns True if there were any.
        """
        data = self.port.read(0)
        read_ns = now_ns()
        if not data:
            return False
        self.unsent = data
        try:
            self.send()
        finally:  # Record the bytes even if they cannot be passed on.
            records.put(self._kind, read_ns, data)
            if self.port.damaged:
                self._errors.note_damaged(data, self.port.damaged, read_ns)
        return True

    def send(self) -> None:
        self.unsent = self.unsent[self.onward.write(self.unsent) :]

    def finish(self, records: RecordWriter) -> None:
        """Send the unsent bytes; then read the port a last time, and send what it returned.

        Each sending takes at most LAST_S seconds. If the first one does not succeed in that time,
        the port is not read.
        """
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
        """Record the driver's reports of damaged and lost bytes, if they are due.

        `at_ns` is the present time in UTC ns.
        """
        put_troubles(records, self._errors.tell(at_ns), self._prefix)

    def tell_all(self, records: RecordWriter) -> None:
        put_troubles(records, self._errors.tell_all(now_ns()), self._prefix)


if __name__ == "__main__":
    main()
