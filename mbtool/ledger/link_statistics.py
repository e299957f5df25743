"""The statistics of one link: the time during which it was watched, and its settings."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

from mbtool.core import SerialFormat

if TYPE_CHECKING:
    from mbtool.devices.named_transaction import NamedTransaction
    from mbtool.ledger.time_bins import Row
    from mbtool.modbus import Transport


class LinkStatistics:
    """The times at which one link was watched, and the settings of a serial line.

    A link is a serial bus, or a slave's address on a network.
    """

    def __init__(self, format_of: Callable[[str], SerialFormat | None], bins: Row) -> None:
        self._format_of = format_of
        self.bins = bins
        """The counts of the link over time, by LinkSum."""
        self.transport: Transport | None = None
        """The transport of the link's last capture; None if the link had no transaction."""
        self.format: SerialFormat | None = None
        """The baud rate and character format of a serial line; None on a network, and if the bytes
        have no times."""
        self.has_times = True
        """False for a serial line whose bytes have no times, because the capture file stores only
        the bytes."""
        self.is_mixed = False
        """True if the baud rate, the character format or the transport of the link differs between
        the captures that were read."""
        self.other_bytes = 0
        """The number of bytes on the line that belong to no frame. This includes the second copy of
        frames that an adapter hears twice, because it hears its own bytes."""
        self.bad_checks = 0
        """The number of frames with a wrong CRC or LRC."""
        self.first_ns: int | None = None
        self.last_ns: int | None = None
        self._earlier_ns = 0
        self.span: tuple[int, int] | None = None
        """The first request and the last response of the present capture (UTC ns); None without
        times."""
        self._is_new = True
        """True until the first transaction of the current capture on this link is noted."""

    def note_span(self, one: NamedTransaction, begin_ns: int, end_ns: int) -> None:
        """Extend the time during which the link was watched, so that it includes `begin_ns` to
        `end_ns` (UTC ns).

        These are the request time and the response time of `one`, or the first and the last such
        time of several equal transactions.
        """
        if self._is_new:
            self._begin_span(one)
        if not self.has_times:
            return
        if self.span is None:
            self.span = begin_ns, end_ns
        elif begin_ns < self.span[0] or end_ns > self.span[1]:
            self.span = min(self.span[0], begin_ns), max(self.span[1], end_ns)

    def _begin_span(self, one: NamedTransaction) -> None:
        is_serial = one.transport.is_serial
        format_ = self._format_of(one.link) if is_serial else None
        if self.transport is not None and (self.transport, self.format) != (one.transport, format_):
            self.is_mixed = True
        self.transport, self.format, self._is_new = one.transport, format_, False
        self.has_times = not is_serial or format_ is not None

    def end_span(self) -> None:
        """End the span of the present capture: the time until the next capture begins does not
        count as watched.
        """
        self._is_new = True
        if self.span is not None:
            self.first_ns, self.last_ns = self.whole_span()
            self._earlier_ns, self.span = self.watched_ns, None

    def whole_span(self) -> tuple[int, int]:
        """The time of the earliest request and that of the latest response in all captures, in UTC
        ns.
        """
        begin, end = self.span or (self.first_ns or 0, self.last_ns or 0)
        begin = begin if self.first_ns is None else min(begin, self.first_ns)
        return begin, end if self.last_ns is None else max(end, self.last_ns)

    @property
    def watched_ns(self) -> int:
        """The time (ns) during which the link was watched: from the first request to the last
        response of each capture, summed over all captures.
        """
        begin, end = self.span or (0, 0)
        return self._earlier_ns + end - begin

    def wire_ns(self, count: int) -> int:
        """The time (ns) that `count` bytes take on the serial line; 0 if its baud rate is
        unknown.
        """
        return 0 if self.format is None else count * self.format.character_ns
