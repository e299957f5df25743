"""Code shared by the two processes that read serial ports: serial_reader.py and serial_relay.py."""

# Such a process ends when its standard input ends, or when nobody reads its output any more
# (child.py). Both happen when the parent process ends, for whatever reason.

from __future__ import annotations

import gc
import os
import signal
import sys
from collections.abc import Callable, Iterable
from contextlib import suppress
from threading import Event, Thread
from typing import TYPE_CHECKING

from mbtool.core import LinkError
from mbtool.ports.clock import now_ns
from mbtool.ports.serial_records import RecordKind, RecordWriter
from mbtool.sources.child import run_promptly

if TYPE_CHECKING:
    from mbtool.ports.line_errors import LineTrouble


def run_process(read: Callable[[RecordWriter, Event], None]) -> None:
    """Prepare this process for reading a port, and call `read`.

    `read` gets the writer for its records, and an event that is set when it must end. If `read`
    raises LinkError, the error's text becomes the last record.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    if hasattr(signal, "SIGTSTP"):  # Ctrl-Z sends it to all processes of the terminal.
        signal.signal(signal.SIGTSTP, signal.SIG_IGN)
    run_promptly()
    gc.disable()  # A garbage collection would delay a time stamp; there are no cycles.
    told_to_end = Event()
    Thread(target=_await_end, args=(told_to_end,), daemon=True).start()
    records = RecordWriter(sys.stdout.fileno())
    error = ""
    with suppress(BrokenPipeError):
        try:
            read(records, told_to_end)
        except LinkError as link_error:
            error = str(link_error)
        records.end(now_ns(), error)


def put_troubles(records: RecordWriter, troubles: Iterable[LineTrouble], prefix: str = "") -> None:
    """Write a driver's reports as records: lost bytes as a number, damaged bytes as a text.

    `prefix` is put before the text; in a serial tap it names the side of the line.
    """
    for trouble in troubles:
        if trouble.lost:
            records.put_count(RecordKind.OVERRUN, trouble.ts_ns, trouble.lost)
        else:
            records.put(RecordKind.DAMAGE, trouble.ts_ns, f"{prefix}{trouble.text}".encode())


def _await_end(told_to_end: Event) -> None:
    while os.read(sys.stdin.fileno(), 1):
        pass
    told_to_end.set()
