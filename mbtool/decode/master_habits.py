"""Learns how the master of a connection sends requests, and the time that its slave takes to
respond.
"""

from __future__ import annotations

from collections.abc import Sequence
from operator import sub
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from mbtool.decode.open_requests import OpenRequest

LATE = 1.5
"""When the master sends its next request, an earlier request counts as given up if it has waited
LATE times the longest latency so far. If the master never pipelines, one such latency is enough."""
SILENT = 3
"""A request that has waited this many times the longest latency so far counts as given up, even if
the master sends nothing more."""
UNUSUAL = 3
"""A response is unusually slow if it takes this many times the mean latency of its function."""
MIN_LATE_NS = 30_000_000
"""The least result (ns) of `late_ns` of a pipelining master, of `silence_ns` and of `slow_ns`."""
FIRST_LATE_NS = 100_000_000
"""The result (ns) of `late_ns`, `silence_ns` and `slow_ns` before the first response. No master has
a shorter response timeout by default."""
FORGET = 20
"""Each response lowers the remembered longest latency by 1/FORGET. So a rare long latency, such as
that of a response which TCP retransmitted, is forgotten."""
FORGOTTEN = 1024
"""After this many further responses, even a latency of 2^64 ns no longer counts (see FORGET)."""
ENOUGH_OVERLAPS = 3
"""The master counts as pipelining once this many responses came while a further request waited."""
ENOUGH_REQUESTS = 8
"""The master counts as never pipelining once this many requests in a row came while no other
request waited."""


class MasterHabits:
    """Learns ids, pipelining and latencies from the requests and responses of a connection."""

    def __init__(self) -> None:
        self.pipelines = False
        """True once the master counts as pipelining: ENOUGH_OVERLAPS responses came while a further
        request waited."""
        self.has_pipelined = False
        """True once a request came while another one waited."""
        self.ids_vary = False
        """True once two requests in a row had different transaction ids."""
        self.ids_count_up = False
        """True if transaction ids vary, and none was less than the one before it (modulo 2^16)."""
        self.has_matching_ids = False
        """True once a response had the transaction id of its request, and transaction ids vary."""
        self.reorders = False
        """True once the slave responded to a request after it had responded to a later one."""
        self._latest_answered = 0
        """The highest number among the requests that got their response; requests are counted from
        1."""
        self.last_response_ns = 0
        """The time at which the last response was complete, in UTC ns; 0 before the first
        response."""
        self.lost_response_ns = 0
        """The last time (ns) at which the capture was found to lack bytes of responses; 0 if it
        lacks none. The responses came before this time."""
        self._slowest_ns: dict[int | None, int] = {}
        """By function code, the longest latency in ns; each response lowers it by 1/FORGET."""
        self._usual_ns: dict[int | None, int] = {}
        """By function code, the mean latency of the last responses, in ns. A latency above twice
        the mean counts as twice the mean."""
        self._fastest_ns: dict[int | None, int] = {}
        """By function code, the shortest latency so far, in ns."""
        self.longest_ns = 0
        """The longest latency of all responses so far, in ns."""
        self._in_a_row = 0
        """The number of requests in a row that came while no other request waited for a
        response."""
        self.is_sequential = False
        """True once ENOUGH_REQUESTS came in a row with no other request waiting; False again once
        the master pipelines."""
        self._overlaps = 0
        self._last_id: int | None = None

    def late_ns(self, function: int | None) -> int:
        """The wait in ns after which a request counts as given up once the next request is sent.

        `function` is its function code; None if the capture lacks the request.
        """
        slowest_ns = self._slowest_of(function)
        if slowest_ns is None:
            return FIRST_LATE_NS
        return slowest_ns if self.is_sequential else max(int(LATE * slowest_ns), MIN_LATE_NS)

    def silence_ns(self, function: int | None) -> int:
        """The wait in ns after which a request counts as given up, even if no request follows.

        `function` is its function code; None if the capture lacks the request.
        """
        slowest_ns = self._slowest_of(function)
        return FIRST_LATE_NS if slowest_ns is None else max(SILENT * slowest_ns, MIN_LATE_NS)

    def slow_ns(self, function: int | None) -> int:
        """The latency in ns that responses to a function code rarely exceed.

        `function` is None for a request that the capture lacks.
        """
        slowest_ns = self._slowest_of(function)
        if slowest_ns is None:
            return FIRST_LATE_NS
        usual_ns = self._usual_ns.get(function, slowest_ns)
        return max(min(int(LATE * slowest_ns), UNUSUAL * usual_ns), MIN_LATE_NS)

    def _slowest_of(self, function: int | None) -> int | None:
        if function in self._slowest_ns:
            return self._slowest_ns[function]
        return max(self._slowest_ns.values(), default=None)

    @property
    def got_response_until_ns(self) -> int:
        """The latest time (ns) at which the master can have got its last response, also one that
        the capture lacks.
        """
        return max(self.last_response_ns, self.lost_response_ns)

    @property
    def has_answered(self) -> bool:
        """True once a captured request surely got its response."""
        return self._latest_answered > 0

    def repeats_id(self, transaction_id: int | None) -> bool:
        """True if ids count up and `transaction_id`, of a new request, is the last id plus 1.

        If the capture lacks a request between the two, that request then had one of the two ids.
        """
        if not self.ids_count_up or transaction_id is None or self._last_id is None:
            return False
        return (transaction_id - self._last_id) & 0xFFFF == 1

    def note_request(self, transaction_id: int | None, *, others_wait: bool) -> None:
        self._in_a_row = 0 if others_wait else self._in_a_row + 1
        self.has_pipelined |= others_wait
        if self._in_a_row >= ENOUGH_REQUESTS:
            self.is_sequential, self.pipelines = True, False
            self._overlaps = 0
        if transaction_id is not None:
            self._note_id(transaction_id)

    def _note_id(self, transaction_id: int) -> None:
        # A retry may have the same transaction id as its first request. So an equal id does not
        # show that the master always sends the same one.
        if self._last_id is not None and transaction_id != self._last_id:
            counts_up = (transaction_id - self._last_id & 0xFFFF) < 0x8000
            self.ids_count_up = counts_up and (self.ids_count_up or not self.ids_vary)
            self.ids_vary = True
        self._last_id = transaction_id

    def note_plain(self, transaction_ids: Sequence[int], number: int, last_ns: int) -> None:
        """Note requests in a row, each answered before the next one came.

        `number` is the number of the last of these requests in its connection, counted from 1;
        `last_ns` is the time of its response.
        """
        self._in_a_row += len(transaction_ids)
        if self._in_a_row >= ENOUGH_REQUESTS:
            self.is_sequential, self.pipelines = True, False
            self._overlaps = 0
        self._note_ids(transaction_ids)
        self.has_matching_ids |= self.ids_vary
        self._latest_answered = max(number, self._latest_answered)
        self.last_response_ns = last_ns

    def _note_ids(self, ids: Sequence[int]) -> None:
        before = ids[0] if self._last_id is None else self._last_id
        steps = {step & 0xFFFF for step in set(map(sub, ids, (before, *ids)))}
        if self._last_id is not None and steps == {0}:
            return  # Equal ids say nothing: a retry may have the same id.
        if self._last_id is not None and all(0 < step < 0x8000 for step in steps):
            self.ids_count_up = self.ids_count_up or not self.ids_vary
            self.ids_vary = True
            self._last_id = ids[-1]
        else:
            for one in ids:
                self._note_id(one)

    def note_latencies(self, function: int, latencies: Sequence[int]) -> None:
        """Note the latencies of several responses with one function code, in ns, in their order."""
        slowest_ns = self._slowest_ns.get(function, 0)
        older = latencies[:-FORGOTTEN]
        if older:
            # FORGOTTEN further responses shrink an older latency below FORGET ns. Then the integer
            # division by FORGET yields 0, and it shrinks no further.
            slowest_ns = min(max(slowest_ns, max(older)), FORGET - 1)
        for latency_ns in latencies[-FORGOTTEN:]:
            slowest_ns = max(slowest_ns - slowest_ns // FORGET, latency_ns)
        self._slowest_ns[function] = slowest_ns
        usual_ns = self._usual_ns.get(function, latencies[0])
        for latency_ns in latencies:  # Does the same as note_latency; min() would be slower.
            most_ns = 2 * usual_ns
            usual_ns = (7 * usual_ns + (latency_ns if latency_ns < most_ns else most_ns)) // 8
        self._usual_ns[function] = usual_ns
        fastest_ns = self._fastest_ns.get(function, latencies[0])
        self._fastest_ns[function] = min(fastest_ns, *latencies)
        self.longest_ns = max(self.longest_ns, *latencies)

    def note_answered(self, number: int) -> None:
        """Note that the request with this number (counted from 1 in the connection) got its
        response.
        """
        self.reorders = self.reorders or number < self._latest_answered
        self._latest_answered = max(number, self._latest_answered)

    def note_overlap(self) -> None:
        """Note a response that came while a further request waited."""
        self._overlaps += 1
        if self._overlaps >= ENOUGH_OVERLAPS:
            self.pipelines, self.is_sequential = True, False

    def note_latency(self, function: int, latency_ns: int) -> None:
        """Note the latency of a response, in ns."""
        slowest_ns = self._slowest_ns.get(function, 0)
        self._slowest_ns[function] = max(slowest_ns - slowest_ns // FORGET, latency_ns)
        usual_ns = self._usual_ns.get(function, latency_ns)
        self._usual_ns[function] = (7 * usual_ns + min(latency_ns, 2 * usual_ns)) // 8
        fastest_ns = self._fastest_ns.get(function, latency_ns)
        self._fastest_ns[function] = min(fastest_ns, latency_ns)
        self.longest_ns = max(self.longest_ns, latency_ns)

    def is_too_early(self, function: int, latency_ns: int) -> bool:
        """True if a latency is less than half the shortest one so far of this function code.

        False if the latency is negative: then the capture has request and response in the wrong
        order.
        """
        return 0 <= 2 * latency_ns < self._fastest_ns.get(function, 0)

    def has_own_id(self, request: OpenRequest, waiting: Sequence[OpenRequest]) -> bool:
        """True if no request that the capture lacks can have the transaction id of `request`.

        `waiting` are all requests that wait for a response, `request` among them.
        """
        if self.ids_count_up:
            return True
        if not self.ids_vary or not waiting or request is not waiting[-1]:
            return False
        same = request.transaction_id
        return sum([one.adu is not None and one.adu.transaction_id == same for one in waiting]) == 1
