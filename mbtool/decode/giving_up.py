"""Finds requests of a TCP connection for whose responses the master no longer waits."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import islice
from typing import TYPE_CHECKING

from mbtool.decode.master_habits import MIN_LATE_NS, MasterHabits

if TYPE_CHECKING:
    from mbtool.decode.open_requests import OpenRequest
    from mbtool.decode.pairing_readings import PairReading
    from mbtool.modbus.adu import Adu


def give_up_late(
    readings: Sequence[PairReading],
    habits: MasterHabits,
    now_ns: int,
    after_ns: Callable[[int | None], int],
) -> None:
    """In each reading, mark the requests that have waited too long at `now_ns` as given up.

    A reading is one way to assign responses to requests. `after_ns` takes a request's function code
    and returns the longest wait in ns; the code is None if the capture lacks the request. A slave
    handles one request at a time, so the wait of a request that was sent while others waited is
    counted from the last response on.
    """
    waits: dict[int | None, int] = {}
    for reading in readings:
        late: list[OpenRequest] = []
        for place, one in enumerate(reading.waiting):
            since_ns = one.since_ns
            if one.number > reading.newest:
                if habits.last_response_ns > since_ns:
                    since_ns = habits.last_response_ns
                if place and one.number in reading.behind_others:
                    if late or one.is_pipelined:
                        break  # It only waits for an earlier request.
                    if reading.gave_up_ns > since_ns:
                        since_ns = reading.gave_up_ns
            function = None if one.adu is None else one.adu.pdu[0]
            if (wait_ns := waits.get(function)) is None:
                wait_ns = waits[function] = after_ns(function)
            if now_ns - since_ns <= wait_ns:
                continue
            if one.number not in reading.given_up and not one.may_not_exist:
                late.append(one)
        if late:
            reading.give_up(late)
            reading.gave_up_ns = now_ns


def give_up_repeated(readings: Sequence[PairReading], habits: MasterHabits, request: Adu) -> None:
    """In each reading, mark the only awaited request as given up if `request` repeats it.

    `request` must have the same unit and PDU and come at least MIN_LATE_NS later, with no response
    in between: a master takes any response, also a late one, for the awaited one, and polls on.
    """
    for reading in readings:
        newest_first = (one for one in reversed(reading.waiting) if reading.awaits(one))
        awaited = [*islice(newest_first, 2)]  # A second one decides; there may be many.
        if len(awaited) != 1 or request.start_ns - awaited[0].since_ns < MIN_LATE_NS:
            continue
        (one,) = awaited
        if one.adu is None or one.number in reading.behind_others:
            continue
        if habits.got_response_until_ns > one.since_ns:
            continue
        if request_key(one.adu) == request_key(request):
            reading.give_up(awaited)


def give_up_lost(readings: Sequence[PairReading], *, is_sequential: bool) -> None:
    """Mark the awaited requests that the capture lacks, when the master sends its next request.

    `is_sequential` is True if the master never pipelines: then it has given these requests up. A
    request is marked `may_not_exist` instead if the lost bytes do not prove that it was sent.
    """
    for reading in readings:
        lost = [one for one in reading.waiting if one.adu is None and reading.awaits(one)]
        for one in lost:
            one.may_not_exist = one.place is None or (is_sequential and not one.exists)
        if is_sequential:
            reading.give_up([one for one in lost if not one.may_not_exist])


def request_key(request: Adu) -> tuple[int, bytes]:
    """Return the unit and PDU of a request; a retry has the same unit and PDU."""
    return request.unit, request.pdu
