"""Tells if the capture of a link ends too early to know that a request has no answer."""

# Nobody is blamed for what a longer capture may have shown. A request counts as not answered only
# if it had USUAL_NS, and also much more time than any response of its link took, unless its master
# gave it up. USUAL_NS leaves time for TCP to send a lost segment again.

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from mbtool.decode.master_habits import MasterHabits
    from mbtool.decode.pairing_readings import PairReading

USUAL_NS = 1_000_000_000
"""The usual response timeout of masters, in ns. `check` gives a request as much time at the end of
a capture (EDGE_NS in devices/checking/responses.py)."""
SLOWER = 3
"""A response may take this many times as long as the slowest one of its link so far."""


def may_be_answered(waited_ns: int, slowest_ns: int, *, is_given_up: bool = False) -> bool:
    """True if the response to a request may still come after `waited_ns`.

    `slowest_ns` is the longest time in which a request of the same link was answered so far.
    """
    return waited_ns < max(USUAL_NS, 0 if is_given_up else SLOWER * slowest_ns)


def unfinished_in(reading: PairReading, habits: MasterHabits, end_ns: int | None) -> set[int]:
    """The numbers of the waiting requests of a connection that may be answered after `end_ns`.

    None of them if `end_ns` is None. A slave begins with a request that others wait behind only
    after its last response.
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
