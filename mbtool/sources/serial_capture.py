"""A serial port as a live source: chunks and silences, read by a process of its own."""

# The reading process (serial_reader.py) notes the time of each read. The thread here only moves the
# records of that process into the inbox, so a delay of the thread changes no times. For a serial
# tap, one process reads both ports and passes the bytes on (serial_relay.py).

from __future__ import annotations

import os
from collections.abc import Mapping
from threading import Event
from typing import TYPE_CHECKING

from mbtool.core import Chunk, Direction, EventKind, LinkError, Quiet, SerialLink, WireEvent
from mbtool.ports.serial_records import RecordKind, RecordReader, SerialRecord
from mbtool.sources.child import end_child, start_child, tell_to_end
from mbtool.sources.inbox import Ended, Sink
from mbtool.sources.source import LiveSource

if TYPE_CHECKING:
    import subprocess


STEP_NS = 10_000
"""Times of reads are rounded down to multiples of this, in ns. A read is noted some 50 us late at
best, and finer times would take twice the space in the log. The decoder gets the same rounded
times."""
_START_S = 20.0
"""Timeout in seconds for the reading process to open its port."""


class SerialSource(LiveSource[SerialLink]):
    """Captures the bytes of one serial port, or of both ports of a serial tap.

    It captures while its context is open. Entering the context raises LinkError if a port cannot be
    opened.
    """

    def __init__(
        self,
        link: SerialLink,
        inbox: Sink,
        speaker: Direction = Direction.UNKNOWN,
        *,
        places: Mapping[str, str] | None = None,
    ) -> None:
        """Create a source for a link.

        `speaker` says whose bytes the port receives: the master's (REQUEST), the slaves' (RESPONSE)
        or both (UNKNOWN). If the link has two ports, `speaker` chooses the port. A serial tap reads
        both ports and ignores `speaker`. `places` gives the present path of a port whose path has
        changed since the link was named.
        """
        super().__init__(link, inbox)
        self._speaker = Direction.REQUEST if link.is_relay else speaker
        self._ports = [(places or {}).get(port, port) for port in link.ports]
        self._port = self._ports[-1 if speaker is Direction.RESPONSE else 0]
        self._first_record = Event()
        self._is_open = False
        self._is_closing = False
        self._error: LinkError | None = None
        self._child: subprocess.Popen[bytes] | None = None

    def open(self) -> None:
        child = self._child = self._start_child()
        self._start_thread(lambda: self._carry(child))
        self._first_record.wait(_START_S)
        if not self._is_open:
            self.close()
            raise self._error or LinkError(f"serial port {self._port}: opening takes too long")

    def tell_to_end(self) -> None:
        """Tell the reading process to end, without waiting for it.

        The last bytes that it reads, and Ended, still go into the inbox.
        """
        self._is_closing = True
        if self._child is not None:
            tell_to_end(self._child)

    def close(self) -> None:
        self.tell_to_end()
        if self._child is not None:
            if self._thread is not None:
                self._thread.join(_START_S)
            end_child(self._child)

    def _start_child(self) -> subprocess.Popen[bytes]:
        settings, modem_lines = str(self._link.format), str(self._link.modem_lines)
        if self._link.is_relay:
            return start_child("mbtool.sources.serial_relay", *self._ports, settings, modem_lines)
        return start_child("mbtool.sources.serial_reader", self._port, settings, modem_lines)

    def _carry(self, child: subprocess.Popen[bytes]) -> None:
        assert child.stdout is not None
        reader = RecordReader()
        while data := os.read(child.stdout.fileno(), 2**16):
            for record in reader.feed(data):
                self._take(record)
        if self._error is None and not self._is_closing:
            self._error = LinkError(
                f"serial port {self._port}: the process that reads it ended by itself "
                f"with status {child.wait()}"
            )
        if self._is_open:
            self._inbox.put(Ended(self.link, self._error))
        self._first_record.set()

    def _take(self, record: SerialRecord) -> None:
        match record.kind:
            case RecordKind.DATA:
                self._hear(record, self._speaker)
            case RecordKind.ANSWER:
                self._hear(record, Direction.RESPONSE)
            case RecordKind.QUIET:
                self._inbox.put(Quiet(record.ts_ns, self.link))
                self._is_open = True
                self._first_record.set()
            case RecordKind.LOST:
                text = f"decoding fell behind: {record.lost} bytes were not recorded"
                self._put_event(record, EventKind.DISCARDED, text, record.lost)
            case RecordKind.DAMAGE:
                self._put_event(record, EventKind.LINE_ERROR, record.data.decode())
            case RecordKind.OVERRUN:
                text = f"overrun: the port's driver lost at least {record.lost} bytes"
                # The driver reports a loss up to a second later. So the event is not a GAP: the
                # decoder would end the frame that is arriving now at a GAP.
                self._put_event(record, EventKind.LINE_ERROR, text, record.lost)
            case RecordKind.STOPPED:
                self._put_event(record, EventKind.GAP, f"{self.link}: {record.data.decode()}")
            case RecordKind.ERROR:
                self._error = LinkError(record.data.decode(errors="replace"))

    def _hear(self, record: SerialRecord, speaker: Direction) -> None:
        ts_ns = record.ts_ns // STEP_NS * STEP_NS
        self._inbox.put(Chunk(ts_ns=ts_ns, link=self.link, data=record.data, direction=speaker))

    def _put_event(
        self, record: SerialRecord, kind: EventKind, text: str, missing: int = 0
    ) -> None:
        self._inbox.put(
            WireEvent(ts_ns=record.ts_ns, link=self.link, kind=kind, message=text, missing=missing)
        )
