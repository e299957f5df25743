"""Finds frames with a wrong CRC or LRC, and which unit sent them (RTU-201)."""

# The unit id in a damaged frame proves nothing. So the frame is taken for the response to the
# request that was pending when it came. This request is known when its transaction ends without a
# response (modbus/response.py); until then the frame waits. On a serial line, the frame stops
# waiting when a transaction begins after it: then it answers no request. On TCP it goes on waiting,
# because a request without a response may end long after later requests (TIMEOUT_NS in
# decode/network_pairing.py).
#
# Memory: at most MAX_FRAMES waiting frames for each of MAX_ENTRIES links (LruDict in
# sliding_window.py).

from __future__ import annotations

from collections import deque
from typing import TYPE_CHECKING

from mbtool.devices.checking.finding import event_finding, transaction_finding
from mbtool.devices.checking.sliding_window import LruDict
from mbtool.devices.checking.transactions import request_text
from mbtool.modbus.response import MAX_FRAMES, DamagedAnswers

if TYPE_CHECKING:
    from collections.abc import Iterator

    from mbtool.core import WireEvent
    from mbtool.devices.checking.finding import Finding
    from mbtool.devices.named_transaction import NamedTransaction

_SHOWN = 16
"""At most so many bytes of a frame are shown."""


class DamagedFrames:
    """Gives a finding for each damaged frame, with the unit if it is known."""

    def __init__(self) -> None:
        self._answers = DamagedAnswers()
        self._waiting: LruDict[str, deque[WireEvent]] = LruDict(deque)

    def event(self, event: WireEvent) -> Iterator[Finding]:
        """Take an event of the kind BAD_CHECK."""
        self._answers.note(event)
        if not self._waiting.has_room([event.link]):
            yield from map(_of_no_unit, self._waiting.pop_oldest())
        waiting = self._waiting[event.link]
        waiting.append(event)
        if len(waiting) > MAX_FRAMES:
            yield _of_no_unit(waiting.popleft())

    def transaction(self, one: NamedTransaction) -> Iterator[Finding]:
        """Take the next transaction."""
        if one.link not in self._waiting:
            return
        waiting = self._waiting[one.link]
        frame_ns = self._answers.frame_of(one)
        past_ns = one.start_ns if one.transport.is_serial else frame_ns or 0
        while waiting and waiting[0].ts_ns < past_ns:
            yield _of_no_unit(waiting.popleft())
        if waiting and waiting[0].ts_ns == frame_ns:
            event = waiting.popleft()
            text = f"unit {one.unit}'s answer to {request_text(one)}: {_text(event)}"
            yield transaction_finding("RTU-201", one, text, ts_ns=event.ts_ns)
        if not waiting:
            self._waiting.pop(one.link)

    def close(self) -> Iterator[Finding]:
        """Give the findings about frames that still wait at the end of the capture."""
        for waiting in self._waiting.values():
            yield from map(_of_no_unit, waiting)


def _of_no_unit(event: WireEvent) -> Finding:
    return event_finding("RTU-201", event, f"unit unknown: {_text(event)}")


def _text(event: WireEvent) -> str:
    shown = event.raw[:_SHOWN].hex(" ") + (" ..." if len(event.raw) > _SHOWN else "")
    return f"{event.message}: {shown}"
