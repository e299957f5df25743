"""Tells if the capture of a link ends too early to know that a request has no answer."""

# A request counts as not answered only if the capture goes on for USUAL_NS after it, and also for
# SLOWER times the longest latency of its link. The second condition does not apply if the master
# gave the request up. USUAL_NS is long enough for TCP to send a lost segment again.

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from mbtool.decode.master_habits import MasterHabits
    from mbtool.decode.pairing_readings import PairReading

USUAL_NS = 1_000_000_000
"""The usual response timeout of masters, in ns. `check` gives a request as much time at the end of
a capture (EDGE_NS in devices/checking/responses.py)."""
SLOWER = 3
"""A request counts as not answered only if the capture goes on after it for this many times the
longest latency of its link so far."""


def may_be_answered(waited_ns: int, slowest_ns: int, *, is_given_up: bool = False) -> bool:
    """True if the response to a request may still come after a wait of `waited_ns`.

    `slowest_ns` is the longest latency on the same link so far, in ns. `is_given_up` is True if the
    master no longer waits for the response.
    """
    return waited_ns < max(USUAL_NS, 0 if is_given_up else SLOWER * slowest_ns)


def unfinished_in(reading: PairReading, habits: MasterHabits, end_ns: int | None) -> set[int]:
    """Return the numbers of the waiting requests that may be answered after `end_ns`.

    `end_ns` is the time at which the capture ended; if it is None, the set is empty. A slave
    handles one request at a time, so the wait of a request that was sent while others waited is
    counted from the last response on. The numbers count the connection's requests from 1.
    """
    if end_ns is None:
        return set()
    found: set[int] = set()
    for one in reading.waiting:
        last_ns = habits.last_response_ns if one.number > reading.newest else 0
        waited_ns = end_ns - max(one.since_ns, last_ns)
        is_given_up = one.number in reading.given_up
        if may_be_answered(waited_ns, habits.longest_ns, is_given_up=is_given_up):
            found.add(one.number)
    return found
