"""Reports the bytes of a serial line that the port's driver marks as damaged or counts as lost."""

# A driver can report damaged bytes in two ways: by marks at single bytes (Unmarker), and by error
# counters. Both are used, since neither is complete: some drivers count but set no marks, some set
# marks but do not count, and lost bytes appear only in the counters.
#
# A single error is reported at once. Further errors are summed up and reported once in GATHER_NS,
# as a wrong baud rate gives thousands of them. The counters are read once in GATHER_NS, too, and
# with each report.
#
# Memory: the number of damaged bytes since the last report, and the first SHOWN of them.

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import astuple, dataclass

from mbtool.core.moments import counted

# Unmarker removes the driver's marks from the bytes read, and returns which bytes were damaged.
#
# With PARMRK set, the bytes that a read of a port returns have these marks (termios(3); Linux
# drivers/tty/n_tty.c):
#
#     FF FF       a byte FF that arrived undamaged
#     FF 00 X     a byte X whose parity bit or stop bit was wrong
#     FF 00 00    a break, or a byte 00 that was damaged
#
# Every other byte stands for itself. A damaged byte stays in the data, since it was on the line. A
# break is returned as a byte 00, as a driver without marks returns it.
#
# A driver puts a whole mark into its buffer at once. So an FF that is the last byte there is, and
# an FF followed by a byte other than FF and 00, are data.
#
# Memory: at most two bytes, the beginning of a mark that continues in the next read.

_MARK = b"\xff"
_DAMAGED = b"\xff\x00"


class Unmarker:
    """Removes the marks from the bytes of consecutive reads, even if a read ends inside a mark."""

    def __init__(self) -> None:
        self._held = b""

    def feed(self, data: bytes) -> tuple[bytes, Sequence[int]]:
        """Return the bytes of one read without marks, and the indexes of the damaged ones.

        The indexes are those in the returned bytes. If the data end inside a mark, its first bytes
        are kept for the next call.
        """
        if not self._held and _MARK not in data:
            return data, ()
        data = self._held + data
        self._held = b""
        heard = bytearray()
        damaged: list[int] = []
        start = 0
        while (at := data.find(_MARK, start)) >= 0:
            heard += data[start:at]
            escape = data[at : at + 3]
            if len(escape) < 3 and escape in (_MARK, _DAMAGED):
                self._held = escape
                return bytes(heard), damaged
            if escape.startswith(_DAMAGED):
                damaged.append(len(heard))
                heard.append(escape[2])
                start = at + 3
            else:
                heard += _MARK
                start = at + (2 if escape[1:2] == _MARK else 1)
        heard += data[start:]
        return bytes(heard), damaged

    def flush(self) -> bytes:
        """Return as data the bytes kept as a possible mark. Call this when no byte follows them."""
        held, self._held = self._held, b""
        return held


GATHER_NS = 1_000_000_000
"""The shortest time between two reports of errors of one port, in ns."""
SHOWN = 8
"""The number of damaged bytes whose values a report shows."""

_COUNTER_MASK = 0xFFFFFFFF


@dataclass(frozen=True, slots=True)
class ErrorCounts:
    """A driver's error counters, 32 bits each. They start at any value and wrap around."""

    frame: int = 0
    overrun: int = 0
    """Characters that the hardware's FIFO had no room for."""
    parity: int = 0
    breaks: int = 0
    buffer_overrun: int = 0
    """Characters that the driver's buffer had no room for."""

    def since(self, before: ErrorCounts) -> ErrorCounts:
        """Return by how much each counter has grown since `before` was read."""
        pairs = zip(astuple(self), astuple(before), strict=True)
        return ErrorCounts(*((after - then) & _COUNTER_MASK for after, then in pairs))

    @property
    def lost(self) -> int:
        return self.overrun + self.buffer_overrun


@dataclass(frozen=True, slots=True)
class LineTrouble:
    """A report of damaged bytes, which `text` describes, or of `lost` bytes (their number)."""

    ts_ns: int
    text: str = ""
    lost: int = 0


class LineErrors:
    """Turns a driver's marks and counters into reports of damaged and of lost bytes.

    In each period of GATHER_NS there is at most one report of damaged and one of lost bytes.
    """

    def __init__(
        self, counts: Callable[[], ErrorCounts | None], character_ns: int, now_ns: int
    ) -> None:
        """`counts` reads the driver's error counters; it returns None if the driver has none.

        `character_ns` is the duration of one character on the line, and `now_ns` the present time,
        both in ns.
        """
        self._counts = counts
        self._character_ns = character_ns
        self._before = counts()
        self._due_ns = now_ns + GATHER_NS
        self._told_ns = now_ns - GATHER_NS
        self._marked = 0
        self._first = bytearray()
        self._first_ns = self._last_ns = 0

    def note_damaged(self, data: bytes, damaged: Sequence[int], ts_ns: int) -> None:
        """Remember the damaged bytes of one read, for the next report.

        `data` are all bytes of the read, and `ts_ns` is the time of the last one, in ns. `damaged`
        has the indexes of the damaged bytes in `data`, at least one.
        """
        if not self._marked:
            self._first_ns = ts_ns - (len(data) - 1 - damaged[0]) * self._character_ns
            self._due_ns = min(self._due_ns, self._told_ns + GATHER_NS)
        self._last_ns = ts_ns - (len(data) - 1 - damaged[-1]) * self._character_ns
        self._marked += len(damaged)
        self._first += bytes(data[at] for at in damaged[: SHOWN - len(self._first)])

    def tell(self, now_ns: int) -> Sequence[LineTrouble]:
        """Return the reports that are due at `now_ns`, usually none. Call this after every read."""
        return () if now_ns < self._due_ns else self.tell_all(now_ns)

    def tell_all(self, now_ns: int) -> list[LineTrouble]:
        """Return reports of all errors not yet reported, even if none is due at `now_ns`."""
        grown = self._grown()
        marked = self._marked_text()
        said = [text for text in (marked, _counted_text(grown)) if text]
        troubles = []
        if said:
            troubles.append(LineTrouble(self._first_ns if marked else now_ns, "; ".join(said)))
        if grown.lost:
            troubles.append(LineTrouble(now_ns, lost=grown.lost))
        if troubles:
            self._told_ns = now_ns
        self._due_ns = now_ns + GATHER_NS
        self._marked = 0
        self._first.clear()
        return troubles

    def _grown(self) -> ErrorCounts:
        counts = self._counts()
        before, self._before = self._before, counts
        return counts.since(before) if counts and before else ErrorCounts()

    def _marked_text(self) -> str:
        if not self._marked:
            return ""
        shown = " ".join(f"{byte:02X}H" for byte in self._first)
        if self._marked == 1:
            a_break = "break, or " if self._first == b"\x00" else ""
            return f"{a_break}parity or framing error at byte {shown}"
        span_s = max(self._last_ns - self._first_ns, 0) / 1e9
        more = " ..." if self._marked > SHOWN else ""
        a_break = " (00H also for a break)" if 0 in self._first else ""
        return (
            f"{self._marked} bytes with a parity or framing error within {span_s:.3f} s: "
            f"{shown}{more}{a_break}"
        )


def _counted_text(grown: ErrorCounts) -> str:
    counts = (
        (grown.parity, "parity error"),
        (grown.frame, "framing error"),
        (grown.breaks, "break"),
    )
    said = [counted(count, noun) for count, noun in counts if count]
    return f"the driver counts {', '.join(said)}" if said else ""
