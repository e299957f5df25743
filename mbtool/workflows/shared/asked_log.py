"""Logs a serial line while a master of this program asks there."""

# The log has two links for the one line. One has the bytes that came while no request of this
# program was pending. The other has the requests of this program, and the bytes that came while
# they were pending. So every command that reads the log shows the two masters of the line apart,
# each with its own polls. Only bytes are logged; they are decoded when the log is read.
#
# Memory: the bytes that the log writer holds until its next flush.

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Self

from mbtool.core import Chunk, SerialLink
from mbtool.logs.links import SPEC
from mbtool.logs.opening import create_log
from mbtool.ports.clock import steady_clock

if TYPE_CHECKING:
    from mbtool.devices import Assignments

_OUR_LINK_SUFFIX = "own"
"""The log has two links for the line: one with its name, for what other masters send and get, and
one for our requests and their answers, whose name also has this word."""


class AskedLog:
    """Writes the bytes of a line to a log; a context manager whose exit closes it."""

    def __init__(
        self, path: str, link: SerialLink, devices: Assignments, *, overwrite: bool
    ) -> None:
        """Create the file. Raises UsageError if it cannot be created."""
        self._log = create_log(path, [link], devices, overwrite=overwrite, evidence_only=True)
        self._names = {False: link.name, True: f"{link.name}-{_OUR_LINK_SUFFIX}"}
        self._log.add_link(self._names[True], {SPEC: str(link)})
        self._ahead_ns = steady_clock()() - time.monotonic_ns()
        """UTC minus the monotonic clock, in ns, measured once."""

    def add(self, data: bytes, at_ns: int, *, is_ours: bool) -> None:
        """Log bytes whose last one came, or was sent, at `at_ns` (ns of the monotonic clock).

        `is_ours` is True for our requests, and for what comes while they are pending.
        """
        self._log.write(Chunk(ts_ns=at_ns + self._ahead_ns, link=self._names[is_ours], data=data))
        self._log.tick(at_ns)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._log.close({})
