"""Finds out when form and acknowledgements prove again which request each response answers."""

# After a loss of an unknown number of requests or responses, all later responses may be paired with
# the wrong request: each belongs to the request sent `shift` places before or after that one. A
# slave answers the requests of one transaction id in order. So until the next loss the shift is the
# same for all responses with this id whose requests follow one another.
#
# A shift is excluded by a single response that cannot belong to the request at that place, because
# of its unit, function or form, or because of acknowledgements. The order is proved once every
# possible shift is excluded. The possible shifts are few: they are smaller than the highest number
# of requests with one id that were open at once so far. After a choice between two readings
# (network_pairing.py) a shift may also equal this number, as a response may have come late.
#
# Memory: MAX_IDS transaction ids, each with its last 2 * MAX_SHIFT requests since the loss.

from __future__ import annotations

from collections import deque
from collections.abc import Iterable
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from mbtool.decode.open_requests import OpenRequest
    from mbtool.decode.stream_progress import AduPlace
    from mbtool.modbus.adu import Adu

MAX_SHIFT = 64
"""Responses are tried with requests up to this many places earlier or later. If a master had more
requests open at once, only a silence ends the doubt."""
MAX_IDS = 64
"""The doubt is examined by transaction id for at most this many ids. At a request with a further
id, all that was excluded so far is forgotten, and the doubt begins anew."""


class OrderDoubt:
    """The doubt since one loss, or since one choice between equally good ways to pair."""

    def __init__(
        self,
        requests: Iterable[OpenRequest],
        *,
        others_answered: bool = False,
        is_of_choice: bool = False,
    ) -> None:
        """`requests` have no response yet. `others_answered` is True if all before them surely have
        theirs.
        """
        self.is_of_choice = is_of_choice
        """True if two ways to pair were equally good; False if the capture lacked bytes."""
        self._queues: dict[int | None, _Queue] = {}
        self._is_whole = others_answered
        """True if no request before those in the queues can get a response."""
        for one in requests:
            self.note_request(one)

    def note_request(self, request: OpenRequest) -> None:
        """Note a request; one that the capture lacks may have any id, and begins the doubt anew."""
        if request.adu is None or len(self._queues) > MAX_IDS:
            self._queues.clear()
            self._is_whole = False
        if request.adu is not None:
            queue = self._queues.setdefault(request.transaction_id, _Queue())
            self._is_whole &= len(queue.requests) < 2 * MAX_SHIFT
            queue.requests.append(request)

    def exclude_shifts(
        self, response: Adu, place: AduPlace | None, request: OpenRequest, most_waiting: int
    ) -> None:
        """Exclude the shifts that are impossible for a response paired with `request`.

        `most_waiting` is the most requests with one id that the master had open at once.
        """
        queue = self._queues.get(request.transaction_id)
        if queue is not None:
            shifts = self._shifts(most_waiting)
            queue.exclude_shifts(response, place, request, shifts, is_whole=self._is_whole)

    def is_settled(self, most_waiting: int) -> bool:
        """True if no other order is possible for a master with at most `most_waiting` open
        requests.
        """
        if most_waiting > MAX_SHIFT or not self._queues:
            return False
        shifts = self._shifts(most_waiting)
        return all(queue.excluded.issuperset(shifts) for queue in self._queues.values())

    def _shifts(self, most_waiting: int) -> list[int]:
        most = min(most_waiting if self.is_of_choice else most_waiting - 1, MAX_SHIFT)
        return [shift for shift in range(-most, most + 1) if shift]


class _Queue:
    """The requests with one transaction id since the loss."""

    def __init__(self) -> None:
        self.requests: deque[OpenRequest] = deque(maxlen=2 * MAX_SHIFT)
        self.excluded: set[int] = set()
        """The shifts that are impossible."""
        self._answered: OpenRequest | None = None
        """The request that was answered last; None if there is none yet."""

    def exclude_shifts(
        self,
        response: Adu,
        place: AduPlace | None,
        request: OpenRequest,
        shifts: list[int],
        *,
        is_whole: bool,
    ) -> None:
        if request not in self.requests:
            return
        at = self.requests.index(request)
        last = self._answered
        if last is not None and last in self.requests and at < self.requests.index(last):
            self.excluded.clear()  # Slaves answer in order, so an earlier pair is wrong.
            return
        if not at or self.requests[at - 1] is not self._answered:
            self.excluded.clear()  # A request got no response, so the shift may change.
        for shift in shifts:
            other = at + shift
            if 0 <= other < len(self.requests):
                is_possible = _may_belong(response, place, self.requests[other])
            else:
                is_possible = other < 0 and not is_whole
            if not is_possible:
                self.excluded.add(shift)
        self._answered = request


def _may_belong(response: Adu, place: AduPlace | None, request: OpenRequest) -> bool:
    return request.can_get(response, place) and request.fits(response)
