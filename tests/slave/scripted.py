"""A responder that does as a test says."""

from __future__ import annotations

import threading
from typing import TYPE_CHECKING

from mbtool.modbus import Response

if TYPE_CHECKING:
    from collections.abc import Callable

PATIENCE_S = 120.0


class Scripted:
    """Answers by a function of unit and PDU, and keeps what it was asked."""

    def __init__(self, script: Callable[[int, bytes], Response | None]) -> None:
        self._script = script
        self.asked: list[tuple[int, bytes]] = []
        self._was_asked = threading.Condition()

    def respond(self, unit: int, pdu: bytes, now_ns: int) -> Response | None:
        with self._was_asked:
            self.asked.append((unit, pdu))
            self._was_asked.notify_all()
        return self._script(unit, pdu)

    def await_asked(self, count: int) -> None:
        """Wait until so many requests have come; fails when they do not."""
        with self._was_asked:
            assert self._was_asked.wait_for(lambda: len(self.asked) >= count, PATIENCE_S)


def echo(unit: int, pdu: bytes) -> Response | None:
    return Response(pdu)
