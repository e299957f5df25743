"""Finds requests that have no answer because their response came with a wrong CRC or LRC."""

# If the CRC or LRC of a frame is wrong, its unit id proves nothing. So the frame is taken for the
# response to the request that was pending when it came. That request is known as soon as its
# transaction ends without a response.
#
# Memory: the times of the last MAX_FRAMES such frames of each line.

from __future__ import annotations

from collections import deque
from typing import TYPE_CHECKING

from mbtool.core import EventKind
from mbtool.modbus.transaction import Outcome

if TYPE_CHECKING:
    from mbtool.core import WireEvent
    from mbtool.modbus.transaction import Transaction

MAX_FRAMES = 16


class DamagedAnswers:
    """Matches damaged frames with requests without a response.

    Give `note` all events, and `has` or `frame_of` all transactions, in the order of a decoder's
    results.
    """

    def __init__(self) -> None:
        self._frames_ns: dict[str, deque[int]] = {}
        """By link, the times (UTC ns) of damaged frames that are not matched with a request yet."""

    def note(self, event: WireEvent) -> None:
        if event.kind is EventKind.BAD_CHECK:
            frames = self._frames_ns.setdefault(event.link, deque(maxlen=MAX_FRAMES))
            frames.append(event.ts_ns)

    def has(self, one: Transaction) -> bool:
        """True if a transaction has no response because a damaged frame was its response.

        Call this or `frame_of` once for each transaction: the damaged frame is then forgotten, as
        it is the response to one request only.
        """
        return self.frame_of(one) is not None

    def frame_of(self, one: Transaction) -> int | None:
        """Return the time (UTC ns) of the damaged frame that was a transaction's response.

        None if there was none.
        """
        if one.outcome is not Outcome.NO_ANSWER or one.link not in self._frames_ns:
            return None
        frames = self._frames_ns[one.link]
        while frames:
            frame_ns = frames.popleft()
            if frame_ns >= one.start_ns:
                return frame_ns
        return None
