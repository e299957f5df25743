"""The process that reads one serial port: python -m mbtool.sources.serial_reader PORT FORMAT."""

# One tight loop: wait, read, take the time, hand over. Nothing else runs in this interpreter, since
# beside a busy decoder the time would be that of the interpreter's next free moment. One record for
# each read; nothing is joined.
#
# A heartbeat (QUIET) comes twice t3.5 after the last byte, so that the end of a frame is told
# without delay, and then every 50 ms. Its time is exact: taken before a look that found nothing.
#
# What the driver tells of damaged and lost bytes follows the bytes (line_errors.py).
#
# The process ends when its standard input ends or its output breaks (child.py), which both happen
# when the parent dies, however it dies.

from __future__ import annotations

import gc
import os
import signal
import sys
from contextlib import suppress
from threading import Event, Thread
from typing import TYPE_CHECKING

from mbtool.core import LinkError, SerialFormat
from mbtool.ports.clock import now_ns
from mbtool.ports.line_errors import LineErrors, LineTrouble
from mbtool.ports.serial_port import IDLE_S, ListeningPort, open_listening
from mbtool.ports.serial_records import RecordKind, RecordWriter
from mbtool.sources.priority import run_promptly

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence


def main() -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    run_promptly()
    gc.disable()  # The loop makes no cycles, and a collection would delay a time stamp.
    port, settings = sys.argv[1:]
    with suppress(BrokenPipeError):
        _read_port(port, SerialFormat.parse(settings), RecordWriter(sys.stdout.fileno()))


def _read_port(port: str, format_: SerialFormat, records: RecordWriter) -> None:
    told_to_end = Event()
    Thread(target=_await_end, args=(told_to_end,), daemon=True).start()
    error = ""
    try:
        source = open_listening(port, format_)
        try:
            records.put(RecordKind.QUIET, now_ns())
            read_until(told_to_end, source, records, format_)
        finally:
            source.close()
    except LinkError as link_error:
        error = str(link_error)
    records.end(now_ns(), error)


def read_until(
    told_to_end: Event, source: ListeningPort, records: RecordWriter, format_: SerialFormat
) -> None:
    """Hand over what arrives until told to end, and what has arrived by then.

    Raises LinkError when the port is lost and BrokenPipeError when the parent is.
    """
    settle_s = min(2 * format_.t3_5_ns / 1e9, IDLE_S)
    wait_s = IDLE_S
    errors = LineErrors(source.counts, format_.character_ns, now_ns())
    try:
        while not told_to_end.is_set():
            asked_ns = now_ns()
            data = source.read(wait_s)
            read_ns = now_ns()
            if data:
                _put_data(records, errors, data, source.damaged, read_ns)
                wait_s = settle_s
            elif wait_s:
                wait_s = 0.0
            else:
                records.put(RecordKind.QUIET, asked_ns)
                wait_s = IDLE_S
            _put_troubles(records, errors.tell(read_ns))
        if data := source.read(0):
            _put_data(records, errors, data, source.damaged, now_ns())
    finally:
        _put_troubles(records, errors.tell_all(now_ns()))


def _put_data(
    records: RecordWriter, errors: LineErrors, data: bytes, damaged: Sequence[int], read_ns: int
) -> None:
    records.put(RecordKind.DATA, read_ns, data)
    if damaged:
        errors.mark(data, damaged, read_ns)


def _put_troubles(records: RecordWriter, troubles: Iterable[LineTrouble]) -> None:
    for trouble in troubles:
        if trouble.lost:
            records.put_count(RecordKind.OVERRUN, trouble.ts_ns, trouble.lost)
        else:
            records.put(RecordKind.DAMAGE, trouble.ts_ns, trouble.text.encode())


def _await_end(told_to_end: Event) -> None:
    while os.read(sys.stdin.fileno(), 1):
        pass
    told_to_end.set()


if __name__ == "__main__":
    main()
