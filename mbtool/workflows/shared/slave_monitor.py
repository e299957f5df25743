"""What a slave is asked and answers, for someone who looks on from another thread."""

# The slave's thread hands over each request with its answer and goes on. Who looks on takes them as
# transactions, named by the device's profile, and asks what stands at its outputs. Behind one whose
# answer was spoilt on purpose comes an event that says how: the transaction has the values that
# were meant, and the bytes that left.
#
# Holds MAX_WAITING exchanges that nobody has taken; what comes while there are so many is counted
# and not kept. So a screen that is slow does not slow the slave.
#
# The time of an answer is when it is due: when its request was complete, and what the slave waits
# on purpose.

from __future__ import annotations

from collections import deque
from dataclasses import replace
from typing import TYPE_CHECKING

from mbtool.core import Direction, EventKind, WireEvent
from mbtool.decode.transactions import Ends, broadcast, no_answer, with_response
from mbtool.devices import Assignment, Assignments, Namer, Who
from mbtool.modbus.adu import Adu, Transport
from mbtool.modbus.distortion import ConnectionEnding, wire_pieces

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    from mbtool.core import LinkSpec
    from mbtool.decode.decoder import Record
    from mbtool.devices import NamedTransaction, Profile
    from mbtool.modbus import Response
    from mbtool.modbus.distortion import Distortion
    from mbtool.modbus.transaction import Transaction
    from mbtool.slave.device import Behaviour, DeviceOutput

MAX_WAITING = 4096
_ENDINGS = {ConnectionEnding.CLOSE: "connection closed", ConnectionEnding.RESET: "connection reset"}


class SlaveMonitor:
    """The exchanges and outputs of the devices on a link."""

    def __init__(
        self, profile: Profile, link: LinkSpec, others: Mapping[int, Profile] | None = None
    ) -> None:
        """`others` are devices beside that of the profile, by their units."""
        beside = [Assignment(Who(unit=unit), one) for unit, one in (others or {}).items()]
        self._assignments = Assignments([Assignment(Who(), profile), *beside])
        self._namer = Namer(self._assignments)
        self._ends = Ends(link.name)
        self._waiting: deque[tuple[Adu, Response | None]] = deque()
        self._missed = 0
        """How many were not kept, all in all; the slave's thread counts."""
        self._missed_told = 0
        self._behaviours: Mapping[int, Behaviour] = {}
        self._outputs: list[DeviceOutput] = []

    def profile_for(self, transaction: NamedTransaction) -> Profile | None:
        return self._assignments.profile_for(transaction)

    # The slave's side.

    def begin(self, behaviours: Mapping[int, Behaviour]) -> None:
        """Learn whose outputs they are, by unit."""
        self._behaviours = behaviours
        self._outputs = self._all_outputs()

    def take(self, request: Adu, answer: Response | None) -> None:
        if len(self._waiting) < MAX_WAITING:
            self._waiting.append((request, answer))
        else:
            self._missed += 1

    # The looker's side.

    def records(self) -> list[Record]:
        """What has come since the last time."""
        return [
            record
            for _ in range(len(self._waiting))
            for record in self._records(*self._waiting.popleft())
        ]

    def missed(self) -> int:
        """How many were not kept since the last time."""
        told, self._missed_told = self._missed_told, self._missed
        return self._missed_told - told

    def changed_outputs(self) -> list[DeviceOutput]:
        """The outputs that have changed since the last time."""
        before, self._outputs = self._outputs, self._all_outputs()
        return [now for was, now in zip(before, self._outputs, strict=True) if now != was]

    def _all_outputs(self) -> list[DeviceOutput]:
        """The outputs of all devices; of several, each with its unit."""
        return [
            one if len(self._behaviours) == 1 else replace(one, name=f"unit {unit} {one.name}")
            for unit, behaviour in self._behaviours.items()
            for one in behaviour.outputs()
        ]

    def _records(self, request: Adu, answer: Response | None) -> Iterator[Record]:
        transaction = self._joined(request, answer)
        yield self._namer.name(transaction)
        if answer is not None and answer.distortion is not None:
            yield WireEvent(
                ts_ns=request.end_ns + answer.delay_ns,
                link=self._ends.link,
                kind=EventKind.SPOILT,
                message=f"the answer above, on purpose: {_how_spoilt(answer.distortion)}",
                raw=transaction.response_raw or b"",
            )

    def _joined(self, request: Adu, answer: Response | None) -> Transaction:
        if answer is None:
            if request.transport is not Transport.TCP and request.unit == 0:
                return broadcast(self._ends, request)
            return no_answer(self._ends, request, 0)
        pieces = wire_pieces(answer, request.transport, request.unit, request.transaction_id or 0)
        if not pieces:
            return no_answer(self._ends, request, 0)
        response = Adu(
            start_ns=request.end_ns + answer.delay_ns,
            end_ns=request.end_ns + answer.delay_ns + pieces[-1][0],
            transport=request.transport,
            direction=Direction.RESPONSE,
            direction_by=request.direction_by,
            confidence=request.confidence,
            unit=request.unit,
            pdu=answer.pdu,
            raw=b"".join(data for _, data in pieces),
            transaction_id=request.transaction_id,
        )
        return with_response(self._ends, request, response, 0, ())


def _how_spoilt(spoiling: Distortion) -> str:
    """What was done to an answer, in the order in which it is done."""
    ending = "" if spoiling.ending is None else _ENDINGS[spoiling.ending]
    if spoiling.silent:
        return ", ".join(filter(None, ("not sent", ending)))
    done = (
        "another unit" if spoiling.unit_by else "",
        "another transaction id" if spoiling.id_by else "",
        "a wrong checksum" if spoiling.wrong_check else "",
        f"bytes missing at its end ({spoiling.cut})" if spoiling.cut else "",
        f"more bytes behind it ({len(spoiling.extra)})" if spoiling.extra else "",
        f"in {spoiling.pieces} pieces" if spoiling.pieces > 1 else "",
        ending,
    )
    return ", ".join(filter(None, done)) or "nothing"
