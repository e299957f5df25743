"""Passes the requests, responses and outputs of a running slave to the thread that shows them."""

# The slave's thread calls `take` with each request and its response, and never waits. The thread
# that shows them calls `records` for the transactions, with names from the device's profile, and
# `changed_outputs` for the simulated outputs that changed. If a simulated fault distorted a
# response, the transaction has the intended values and the bytes that were really sent; the event
# after it says how the response was distorted.
#
# Memory: at most `limit` requests that have not been shown yet. Further requests are counted and
# dropped, so that a slow screen does not delay the slave.
#
# The time of a response is the time at which it should be sent: the end of its request plus the
# slave's delay.

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from typing import TYPE_CHECKING

from mbtool.core import Direction, EventKind, LinkSpec, WireEvent
from mbtool.decode.transactions import Ends, broadcast, no_answer, with_response
from mbtool.devices import Assignment, Assignments, NamedTransaction, Namer, Profile, Who
from mbtool.modbus.adu import Adu
from mbtool.modbus.response import ConnectionEnding, Distortion, wire_pieces

if TYPE_CHECKING:
    from mbtool.decode.decoder import Record
    from mbtool.modbus import Response
    from mbtool.modbus.transaction import Transaction
    from mbtool.slave.device import Behaviour, DeviceOutput

MAX_PENDING = 4096
_ENDINGS = {ConnectionEnding.CLOSE: "connection closed", ConnectionEnding.RESET: "connection reset"}


class SlaveMonitor:
    """Passes the requests, responses and outputs of the simulated devices on a link to a screen."""

    def __init__(
        self,
        profile: Profile | None,
        link: LinkSpec,
        others: Mapping[int, Profile] | None = None,
        *,
        limit: int = MAX_PENDING,
        is_recorded: Callable[[int, bytes], bool] | None = None,
    ) -> None:
        """Prepare to pass on what happens on `link`.

        `others` are the profiles of single units; `profile` is for all other units, None for no
        profile. At most `limit` requests wait to be shown. `is_recorded` returns True for a request
        that the recording has, given its unit and PDU; None if no recording is played.
        """
        self._is_recorded = is_recorded
        beside = [Assignment(Who(unit=unit), one) for unit, one in (others or {}).items()]
        own = [] if profile is None else [Assignment(Who(), profile)]
        self._assignments = Assignments([*own, *beside])
        self._limit = limit
        self._namer = Namer(self._assignments)
        self._ends = Ends(link.name)
        self._pending: deque[tuple[Adu, Response | None]] = deque()
        self._missed = 0
        """The number of requests dropped since the start, as too many waited; only the slave's
        thread changes it."""
        self._missed_told = 0
        self._behaviours: Mapping[int, Behaviour] = {}
        self._outputs: list[DeviceOutput] = []

    @property
    def assignments(self) -> Assignments:
        return self._assignments

    @property
    def behaviours(self) -> Mapping[int, Behaviour]:
        """The simulated device (its Behaviour) of each unit; empty before `begin` is called."""
        return self._behaviours

    def profile_for(self, transaction: NamedTransaction) -> Profile | None:
        return self._assignments.profile_for(transaction)

    def on_link(self, name: str) -> None:
        """Set the link name for all further records.

        If the user chose TCP port 0, the system chooses the port. So the name is known only when
        the port is open.
        """
        self._ends = Ends(name)

    # Only the slave's thread calls `begin` and `take`.

    def begin(self, behaviours: Mapping[int, Behaviour]) -> None:
        """Set the simulated device (its Behaviour) of each unit. Call it before the first
        request.
        """
        self._behaviours = behaviours
        self._outputs = self._all_outputs()

    def take(self, request: Adu, response: Response | None) -> None:
        if len(self._pending) < self._limit:
            self._pending.append((request, response))
        else:
            self._missed += 1

    # Only the thread that shows the requests calls `records`, `missed` and `changed_outputs`.

    def records(self) -> list[Record]:
        """Return the transactions and events that have come since the last call."""
        return [
            record
            for _ in range(len(self._pending))
            for record in self._records(*self._pending.popleft())
        ]

    def missed(self) -> int:
        """Return the number of requests that were dropped since the last call, because too many
        waited to be shown.
        """
        told, self._missed_told = self._missed_told, self._missed
        return self._missed_told - told

    def changed_outputs(self) -> list[DeviceOutput]:
        """Return the outputs of the simulated devices that have changed since the last call."""
        before, self._outputs = self._outputs, self._all_outputs()
        return [now for was, now in zip(before, self._outputs, strict=True) if now != was]

    def _all_outputs(self) -> list[DeviceOutput]:
        """Return all outputs of all simulated devices. If there are several devices, each name
        begins with the unit.
        """
        return [
            one if len(self._behaviours) == 1 else replace(one, name=f"unit {unit} {one.name}")
            for unit, behaviour in self._behaviours.items()
            for one in behaviour.outputs()
        ]

    def _records(self, request: Adu, response: Response | None) -> Iterator[Record]:
        transaction = self._transaction(request, response)
        yield self._namer.name(transaction)
        if self._is_recorded is not None and not self._is_recorded(request.unit, request.pdu):
            yield WireEvent(
                ts_ns=request.end_ns,
                link=self._ends.link,
                kind=EventKind.UNRECORDED,
                message="the request above was never recorded",
            )
        if response is not None and response.distortion is not None:
            yield WireEvent(
                ts_ns=request.end_ns + response.delay_ns,
                link=self._ends.link,
                kind=EventKind.SPOILT,
                message=f"the answer above, on purpose: {_how_spoilt(response.distortion)}",
                raw=transaction.response_raw or b"",
            )

    def _transaction(self, request: Adu, response: Response | None) -> Transaction:
        if response is None:
            if not request.transport.has_mbap and request.unit == 0:
                return broadcast(self._ends, request)
            return no_answer(self._ends, request, 0)
        pieces = wire_pieces(response, request.transport, request.unit, request.transaction_id or 0)
        if not pieces:
            return no_answer(self._ends, request, 0)
        sent = Adu(
            start_ns=request.end_ns + response.delay_ns,
            end_ns=request.end_ns + response.delay_ns + pieces[-1][0],
            transport=request.transport,
            direction=Direction.RESPONSE,
            direction_by=request.direction_by,
            confidence=request.confidence,
            unit=request.unit,
            pdu=response.pdu,
            raw=b"".join(data for _, data in pieces),
            transaction_id=request.transaction_id,
        )
        return with_response(self._ends, request, sent, 0, ())


def _how_spoilt(spoiling: Distortion) -> str:
    """Return a text that lists how a simulated fault has changed a response: the changes, separated
    by commas.
    """
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
