"""Removes the terminal driver's marks from the bytes read, and returns which bytes were damaged."""

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

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Sequence

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
