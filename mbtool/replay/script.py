"""Prepares a recording to be played as the master: its requests, their times and responses."""

# A step is one recorded request. It is sent at its recorded time, but it waits for the responses
# that the recorded master had already received when it sent this request. It does not wait for
# requests that were still without a response then. So the player has as many requests pending at
# once as the recorded master had. No step waits for a request that was never answered.
#
# Unsolicited responses have no request and are left out; a retry is a request like any other.
#
# Memory grows with the recording: one step for each request, and in its `open_before` one number
# for each request that was pending at the same time.

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
    """One recorded request, to be sent again by the player."""

    number: int
    """The index of this step in the script, from 0."""
    position_ns: int
    """The time at which the last byte of the request was sent, in ns since the last byte of the
    recording's first request."""
    unit: int
    pdu: bytes
    expected: bytes | None
    """The PDU of the recorded response; None if there was none, or if the capture lost it."""
    latency_ns: int | None
    """The latency of the recorded response in ns; None if there was none."""
    is_broadcast: bool
    reference: str
    """The addresses in the request, in the notation of the device; empty if it has none."""
    function_name: str
    device: str | None
    """The name of the slave's device profile; None if it has none."""
    is_captured: bool = True
    """False if the capture lost the response, so that nobody knows if there was one."""
    open_before: tuple[int, ...] = ()
    """The numbers of the earlier steps whose responses came only after this request was recorded,
    so that the recorded master did not wait for them. The player does not wait for these either,
    but for all other earlier steps that have a recorded response."""


@dataclass(frozen=True, slots=True)
class Script:
    """The requests of a recording, as steps, in the order in which they were sent."""

    steps: tuple[Step, ...]

    @classmethod
    def of(cls, transactions: Iterable[NamedTransaction]) -> Self:
        """Build a script; the transactions may come in any order."""
        asked = [
            (one.request_ns, pdu, one)
            for one in transactions
            if one.request_raw is not None and one.request_ns is not None
            if (pdu := whole_pdu(one.transport, one.request_raw)) is not None
        ]
        asked.sort(key=lambda each: each[0])
        steps: list[Step] = []
        pdus: dict[bytes, bytes] = {}
        """Each PDU as key and as value, so that equal PDUs share one bytes object and memory is
        saved."""
        open_until: dict[int, int] = {}
        """The requests that were pending when the present request was recorded. The key is the
        number of the request's step, the value the time (UTC ns) at which its response came."""
        for number, (request_ns, pdu, one) in enumerate(asked):
            for each in [each for each, end in open_until.items() if end <= request_ns]:
                del open_until[each]
            while len(open_until) > MAX_OPEN_REQUESTS:
                del open_until[next(iter(open_until))]
            steps.append(
                Step(
                    number=number,
                    position_ns=request_ns - asked[0][0],
                    unit=one.unit,
                    pdu=pdus.setdefault(pdu, pdu),
                    expected=whole_pdu(one.transport, one.response_raw),
                    latency_ns=one.latency_ns,
                    is_broadcast=one.outcome is Outcome.BROADCAST,
                    reference=intern(one.reference or ""),
                    function_name=one.function_name,
                    device=one.device,
                    is_captured=one.outcome is not Outcome.NOT_CAPTURED,
                    open_before=tuple(open_until),
                )
            )
            if one.response_ns is not None:
                open_until[number] = one.response_ns
        return cls(tuple(steps))

    @property
    def length_ns(self) -> int:
        """The time (ns) from the first request of the script to the last."""
        return self.steps[-1].position_ns if self.steps else 0

    @property
    def units(self) -> frozenset[int]:
        """The units that the requests are for, except broadcasts."""
        return frozenset(step.unit for step in self.steps if not step.is_broadcast)
