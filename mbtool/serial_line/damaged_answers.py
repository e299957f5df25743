"""Finds the requests without answer whose answer came, but with a wrong CRC or LRC."""

# The check of such a frame is wrong, so its unit id proves nothing. It is taken for the answer to
# the request that was open when it came, which is known when that request turns out to have none.
#
# Memory: the times of the last MAX_FRAMES such frames of each line.

from __future__ import annotations

from collections import deque
from typing import TYPE_CHECKING

from mbtool.core import EventKind
from mbtool.modbus import Outcome

if TYPE_CHECKING:
    from mbtool.core import WireEvent
    from mbtool.modbus import Transaction

MAX_FRAMES = 16


class DamagedAnswers:
    """Takes all events, and all transactions, in the order in which they were decoded."""

    def __init__(self) -> None:
        self._frames_ns: dict[str, deque[int]] = {}
        """By link, the times (UTC ns) of frames that belong to no request yet."""

    def note(self, event: WireEvent) -> None:
        if event.kind is EventKind.BAD_CHECK:
            frames = self._frames_ns.setdefault(event.link, deque(maxlen=MAX_FRAMES))
            frames.append(event.ts_ns)

    def has(self, one: Transaction) -> bool:
        """True if a transaction has no answer because its answer is one of these frames.

        A frame is the answer to one request only, so each transaction is asked for once.
        """
        if one.outcome is not Outcome.NO_ANSWER or one.link not in self._frames_ns:
            return False
        frames = self._frames_ns[one.link]
        while frames:
            if frames.popleft() >= one.start_ns:
                return True
        return False
