"""Tells the user which serial lines are unreadable, probably because their settings are wrong."""

# With a wrong baud rate, and with most wrong parities, a receiver delivers bytes that were never
# sent. The right settings cannot be found from them, so the user is advised to listen again with
# LINK@auto. With the wrong mode (RTU for ASCII), or with 8 data bits instead of 7, the sent bytes
# can still be recovered. Then the user is advised to use the settings with which the unreadable
# bytes are frames with a correct CRC or LRC (serial_line/settings_fit.py).
#
# A line is unreadable if at least MIN_BYTES of its bytes are in no frame, less than MAX_READ_SHARE
# of all bytes are in frames, and most requests stay without an answer. In a live capture the user
# is told after SOON_BYTES unreadable bytes, or SOON_NS after the first of them; otherwise at the
# end.
#
# Memory: for each serial line, some numbers, and events with about SAMPLE_BYTES bytes.

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from mbtool.core import EventKind, LineSettings, SerialLink, WireEvent
from mbtool.serial_line.settings_fit import (
    ENOUGH_BYTES,
    ENOUGH_WITHOUT_FRAME,
    LIKELY_FIT,
    SettingsScore,
    SettingsTrial,
)

if TYPE_CHECKING:
    from mbtool.decode.decoder import Record

MIN_BYTES = ENOUGH_WITHOUT_FRAME
MAX_READ_SHARE = LIKELY_FIT
ANSWERED = 5
"""If at least this many requests, and half of all, are answered, the line settings are not called
wrong, whatever else is on the line."""
SAMPLE_BYTES = SOON_BYTES = ENOUGH_BYTES
SOON_NS = 3_000_000_000

_RTU_DATA_BITS = 8
_UNREAD = frozenset((EventKind.SKIPPED, EventKind.BAD_CHECK))

LineOf = Callable[[str], SerialLink | None]
"""A function that returns the serial line with a link name; None if the link is no serial line."""


@dataclass(slots=True)
class _HeardLine:
    read: int = 0
    unread: int = 0
    requests: int = 0
    answered: int = 0
    first: WireEvent | None = None
    """The first event about bytes of the line that could not be read; None if there was none."""
    sample: list[WireEvent] = field(default_factory=list)
    """The first events about bytes that could not be read, until they have SAMPLE_BYTES bytes in
    all."""
    is_told: bool = False

    @property
    def is_unreadable(self) -> bool:
        total = self.read + self.unread
        is_answered = self.answered >= ANSWERED and self.answered * 2 >= self.requests
        is_little = self.read < MAX_READ_SHARE * total
        return self.unread >= MIN_BYTES and is_little and not is_answered

    def add(self, event: WireEvent) -> None:
        self.first = self.first or event
        if self.unread < SAMPLE_BYTES:
            self.sample.append(event)
        self.unread += len(event.raw)


class UnreadableLines:
    """Counts, for each serial line, the bytes that could be read and those that could not."""

    def __init__(self, line_of: LineOf, *, is_live: bool = False) -> None:
        """`line_of` returns the serial line with a link name. `is_live` is True in a live capture:
        then messages can name the serial ports.
        """
        self._line_of = line_of
        self._is_live = is_live
        self._lines: dict[str, _HeardLine] = {}

    def note(self, record: Record) -> str | None:
        """Look at the next transaction or event. Return a message for the user if it shows that its
        serial line is unreadable, else None.

        There is at most one message for each line.
        """
        if not isinstance(record, WireEvent):
            if record.transport.is_serial:
                request, response = record.request_raw, record.response_raw
                heard = self._lines.get(record.link) or self._line_of_link(record.link)
                heard.read += len(request or b"") + len(response or b"")
                heard.requests += request is not None
                heard.answered += request is not None and response is not None
            return None
        if record.kind not in _UNREAD or record.source or record.destination:
            return None
        heard = self._line_of_link(record.link)
        heard.add(record)
        first_ns = heard.first.ts_ns if heard.first is not None else record.ts_ns
        is_soon = heard.unread >= SOON_BYTES or record.ts_ns - first_ns >= SOON_NS
        if heard.is_told or not is_soon or not heard.is_unreadable:
            return None
        return self._first_remark(record.link, heard)

    def untold(self) -> Iterator[str]:
        """Yield a message for each unreadable line that `note` has not reported. Call it at the
        end.
        """
        for link, heard in self._lines.items():
            if heard.is_unreadable and not heard.is_told:
                yield self._first_remark(link, heard)

    def unreadable(self) -> Iterator[tuple[WireEvent, str]]:
        """Yield a pair for each unreadable line: the first event about unreadable bytes, and a text
        that says what the user can do.
        """
        for link, heard in self._lines.items():
            if heard.first is not None and heard.is_unreadable:
                yield heard.first, self._text(link, heard)

    def _line_of_link(self, link: str) -> _HeardLine:
        heard = self._lines.get(link)
        if heard is None:
            heard = self._lines[link] = _HeardLine()
        return heard

    def _first_remark(self, link: str, heard: _HeardLine) -> str:
        heard.is_told = True
        return f"{link}: {self._text(link, heard)}"

    def _text(self, link: str, heard: _HeardLine) -> str:
        line = self._line_of(link)
        total = heard.read + heard.unread
        read = f"only {heard.read}" if heard.read else "none"
        settings = f" with {line.scheme}@{line.format}" if line is not None else ""
        port = ",".join(line.ports) if line is not None and self._is_live else "PORT"
        fit = _fitting(line, heard) if line is not None else None
        if fit is None:
            remedy = f"mbtool sniff rtu:{port}@auto finds them by listening, RTU or ASCII"
        else:
            mode = "ascii" if fit.settings.ascii else "rtu"
            remedy = f"{mode}:{port}@{fit.settings.format} fits these bytes ({fit})"
        return (
            f"of {total} bytes {read} can be read{settings}, so the settings are probably wrong; "
            f"{remedy}"
        )


def _fitting(line: SerialLink, heard: _HeardLine) -> SettingsScore | None:
    """Return the line settings with which the unreadable bytes in `heard` are frames with a correct
    CRC or LRC.

    None if no settings fit, or only the present ones of `line`.
    """
    trial = SettingsTrial(line.format)
    for event in heard.sample:
        trial.feed(event.raw, (), event.ts_ns + (len(event.raw) - 1) * line.format.character_ns)
    trial.advance(1 << 62)
    best = trial.scores()[0]
    present = LineSettings(line.format, line.ascii)
    if not best.is_likely or best.settings == present:
        return None
    # With 7 data bits, RTU frames whose bytes are all below 80H seem correct, but RTU needs 8 bits.
    is_possible = best.settings.ascii or best.settings.format.data_bits == _RTU_DATA_BITS
    return best if is_possible else None
