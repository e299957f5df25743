"""Finds the requests of a connection that their master has given up."""

from __future__ import annotations

from typing import TYPE_CHECKING

from mbtool.decode.master_habits import MIN_LATE_NS

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from mbtool.decode.master_habits import MasterHabits
    from mbtool.decode.open_requests import OpenRequest
    from mbtool.decode.pairing_readings import PairReading
    from mbtool.modbus.adu import Adu


def give_up_late(
    readings: Sequence[PairReading],
    habits: MasterHabits,
    now_ns: int,
    after_ns: Callable[[int | None], int],
) -> None:
    """Give up the requests that have waited too long, in each reading.

    `after_ns` gives the longest wait for a function code, in ns. The slave takes one request after
    the other, so a request that was sent behind others waits only from the last response on.
    """
    for reading in readings:
        late: list[OpenRequest] = []
        for place, one in enumerate(reading.waiting):
            since_ns = one.since_ns
            if one.number > reading.newest:
                since_ns = max(since_ns, habits.last_response_ns)
                if place and one.number in reading.behind_others:
                    if late or one.is_pipelined:
                        break  # Only the first late one is slow; the others wait behind it.
                    since_ns = max(since_ns, reading.gave_up_ns)
            if now_ns - since_ns > after_ns(one.function) and reading.awaits(one):
                late.append(one)
        if late:
            reading.give_up(late)
            reading.gave_up_ns = now_ns


def give_up_repeated(readings: Sequence[PairReading], request: Adu) -> None:
    """Give up a request that its master sends again, if no other one waits."""
    for reading in readings:
        awaited = [one for one in reading.waiting if reading.awaits(one)]
        if len(awaited) != 1 or request.start_ns - awaited[0].since_ns < MIN_LATE_NS:
            continue
        (one,) = awaited
        if one.adu is None or one.number in reading.behind_others:
            continue
        if request_key(one.adu) == request_key(request):
            reading.give_up(awaited)


def give_up_lost(readings: Sequence[PairReading], *, is_sequential: bool) -> None:
    """Give up requests that the capture lacks, as the master now sends the next one."""
    for reading in readings:
        lost = [one for one in reading.waiting if one.adu is None and reading.awaits(one)]
        for one in lost:
            one.may_not_exist = one.place is None or (is_sequential and not one.exists)
        if is_sequential:
            reading.give_up([one for one in lost if not one.may_not_exist])


def request_key(request: Adu) -> tuple[int, bytes]:
    """The unit and PDU of a request; a repetition of the request has the same."""
    return request.unit, request.pdu
