"""A recording made ready to be played as the master: what to ask, when, and what came back."""

# A step is one recorded request. It is asked when its recorded time comes, and not before those
# that it came after in the recording: a step waits for each earlier one whose answer the recorded
# master had when it asked. Those that were still open then may be open again, so a master that
# asked several at once does it again, and one that did not, does not. Requests that were never
# answered are waited for by nobody.
#
# Unsolicited answers have no request and are left out; a retry is a request like any other.
#
# Memory grows with the recording: a step for each request. `open_before` holds as many numbers as
# there were requests open at once.

from __future__ import annotations

from dataclasses import dataclass
from sys import intern
from typing import TYPE_CHECKING, Self

from mbtool.core.limits import MAX_OPEN_REQUESTS
from mbtool.modbus import Outcome, whole_pdu

if TYPE_CHECKING:
    from collections.abc import Iterable

    from mbtool.devices import NamedTransaction


@dataclass(frozen=True, slots=True)
class Step:
    """One request of the recording."""

    number: int
    """Its place, from 0."""
    place_ns: int
    """When it was complete, since the first request."""
    unit: int
    pdu: bytes
    expected: bytes | None
    """The PDU that came back; None where there was none."""
    latency_ns: int | None
    is_broadcast: bool
    reference: str
    """What it addresses, in the notation of its device."""
    function_name: str
    device: str | None
    """The name of the profile, if there is one."""
    open_before: tuple[int, ...] = ()
    """The earlier steps that were answered later; all others that were answered must be over."""


@dataclass(frozen=True, slots=True)
class Script:
    """The steps, in the order of their requests."""

    steps: tuple[Step, ...]

    @classmethod
    def of(cls, transactions: Iterable[NamedTransaction]) -> Self:
        """Build a script; the transactions may come in any order."""
        asked = [
            (one.request_ns, pdu, one)
            for one in transactions
            if one.outcome is not Outcome.UNSOLICITED and one.request_ns is not None
            if (pdu := whole_pdu(one.transport, one.request_raw)) is not None
        ]
        asked.sort(key=lambda each: each[0])
        steps: list[Step] = []
        pdus: dict[bytes, bytes] = {}
        """What is asked again and again is kept once."""
        open_until: dict[int, int] = {}
        """By number, the steps that are open, and until when."""
        for number, (request_ns, pdu, one) in enumerate(asked):
            for each in [each for each, end in open_until.items() if end <= request_ns]:
                del open_until[each]
            while len(open_until) > MAX_OPEN_REQUESTS:
                del open_until[next(iter(open_until))]
            steps.append(
                Step(
                    number=number,
                    place_ns=request_ns - asked[0][0],
                    unit=one.unit,
                    pdu=pdus.setdefault(pdu, pdu),
                    expected=whole_pdu(one.transport, one.response_raw),
                    latency_ns=one.latency_ns,
                    is_broadcast=one.outcome is Outcome.BROADCAST,
                    reference=intern(one.reference or ""),
                    function_name=one.function_name,
                    device=one.device,
                    open_before=tuple(open_until),
                )
            )
            if one.response_ns is not None:
                open_until[number] = one.response_ns
        return cls(tuple(steps))

    @property
    def length_ns(self) -> int:
        """From the first request to the last."""
        return self.steps[-1].place_ns if self.steps else 0

    @property
    def units(self) -> frozenset[int]:
        """The units that are asked, broadcasts apart."""
        return frozenset(step.unit for step in self.steps if not step.is_broadcast)
