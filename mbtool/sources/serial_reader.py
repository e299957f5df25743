"""The process that reads one serial port: mbtool.sources.serial_reader PORT FORMAT DTR,RTS."""

# The loop waits, reads, notes the time and writes a record. Each read becomes one record. Nothing
# else runs in this process: a busy decoder would make the loop wait for the interpreter, and the
# noted times would be too late.
#
# A QUIET record follows when the line has been silent for twice t3.5, so that the end of a frame is
# known without delay, and then every 50 ms. The time of a QUIET record is noted before a read that
# returned no bytes, so the line was certainly silent up to it.
#
# If a read takes longer than STOPPED_NS, the process was stopped, or the machine slept. Then a
# STOPPED record comes before the bytes of that read, because the driver keeps only some of the
# bytes that came meanwhile.
#
# The driver's reports of damaged and lost bytes follow the record of the bytes that were read
# (ports/line_errors.py).

from __future__ import annotations

import sys
from collections.abc import Sequence
from contextlib import closing
from functools import partial
from typing import TYPE_CHECKING

from mbtool.core import SerialFormat
from mbtool.core.serial_format import ModemLines
from mbtool.ports.clock import now_ns
from mbtool.ports.line_errors import LineErrors
from mbtool.ports.serial_opening import open_listening
from mbtool.ports.serial_port import IDLE_S, ListeningPort
from mbtool.ports.serial_records import RecordKind, RecordWriter
from mbtool.sources.serial_process import put_troubles, run_process

if TYPE_CHECKING:
    from threading import Event


STOPPED_NS = 2_000_000_000
"""A read that takes longer than this, in ns, shows that the process was stopped. A read should take
IDLE_S at most; on a busy machine it has been late by tenths of a second."""


def main() -> None:
    port, settings, lines = sys.argv[1:]
    format_, modem_lines = SerialFormat.parse(settings), ModemLines.parse(lines)
    run_process(partial(_read_port, port, format_, modem_lines))


def _read_port(
    port: str,
    format_: SerialFormat,
    modem_lines: ModemLines,
    records: RecordWriter,
    told_to_end: Event,
) -> None:
    with closing(open_listening(port, format_, modem_lines)) as source:
        records.put(RecordKind.QUIET, now_ns())
        read_until(told_to_end, source, records, format_)


def read_until(
    told_to_end: Event, source: ListeningPort, records: RecordWriter, format_: SerialFormat
) -> None:
    """Record all bytes that arrive at the port until `told_to_end` is set.

    Raises LinkError when the port is gone, and BrokenPipeError when the parent process has ended.
    """
    settle_s = min(2 * format_.t3_5_ns / 1e9, IDLE_S)
    wait_s = IDLE_S
    errors = LineErrors(source.counts, format_.character_ns, now_ns())
    try:
        while not told_to_end.is_set():
            asked_ns = now_ns()
            data = source.read(wait_s)
            read_ns = now_ns()
            if read_ns - asked_ns > STOPPED_NS:
                stopped_s = (read_ns - asked_ns) / 1e9
                text = (
                    f"nothing was read for {stopped_s:.1f} s: this program or machine was stopped"
                )
                records.put(RecordKind.STOPPED, asked_ns, text.encode())
            if data:
                _put_data(records, errors, data, source.damaged, read_ns)
                wait_s = settle_s
            elif wait_s:
                wait_s = 0.0
            else:
                records.put(RecordKind.QUIET, asked_ns)
                wait_s = IDLE_S
            put_troubles(records, errors.tell(read_ns))
        if data := source.read(0):
            _put_data(records, errors, data, source.damaged, now_ns())
    finally:
        put_troubles(records, errors.tell_all(now_ns()))


def _put_data(
    records: RecordWriter, errors: LineErrors, data: bytes, damaged: Sequence[int], read_ns: int
) -> None:
    records.put(RecordKind.DATA, read_ns, data)
    if damaged:
        errors.note_damaged(data, damaged, read_ns)


if __name__ == "__main__":
    main()
