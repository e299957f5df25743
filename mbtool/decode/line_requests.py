"""The requests of a serial line that have no response yet, though another request followed them."""

# A request stays open until its unit answers a later request, until the unit has left more than
# MAX_OF_UNIT requests in a row without a response, or until the caller takes it out as too old. A
# unit that has left so many requests unanswered counts as switched off: its further requests stay
# open only if a second master may have sent the next request while the first one still waited.
#
# Memory: MAX_OPEN requests, and one record of times for each of at most 247 units.

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

from mbtool.modbus.expected_response import ExpectedResponse, is_response_code

if TYPE_CHECKING:
    from mbtool.modbus.adu import Adu

MAX_OF_UNIT = 4
"""The most open requests of one unit."""
MAX_OPEN = 32
"""The most open requests of one line."""
ENOUGH_TIMES = 3
"""The times of a unit are known once it has sent so many responses in time."""
BLOCK_NS = 16_000_000
"""FTDI adapters deliver every 16 ms (in ns) by default."""
UNUSUAL = 2
"""A response may take this many times as long as the slowest one of its unit so far."""


class OpenLineRequest(NamedTuple):
    """A request without a response that was not the line's last one."""

    adu: Adu
    next_number: int
    """The number of the request that followed it; the line's requests are counted from 1."""
    waited_ns: int
    """The time from its end to the start of the next request."""
    waits: bool | None
    """True if its master certainly still waited when the next request was sent, False if it had
    given the request up, None if the times do not tell."""


class _Unit:
    """The times that one unit takes to respond, in ns, and its requests without a response."""

    __slots__ = ("fastest_ns", "number", "silent", "slowest_ns")

    def __init__(self) -> None:
        self.silent = 0
        """The number of requests in a row without a response."""
        self.number = 0
        self.fastest_ns = 1 << 63
        self.slowest_ns = 0


class OpenLineRequests:
    """Holds open requests, the oldest first."""

    def __init__(self) -> None:
        self.open: list[OpenLineRequest] = []
        """The open requests, the oldest first. The caller only reads it."""
        self._units: dict[int, _Unit] = {}

    def add(self, one: OpenLineRequest) -> list[OpenLineRequest]:
        """Add a request that another one followed; return the requests that no longer stay open."""
        number = one.adu.unit
        unit = self._of(number)
        unit.silent += 1
        if one.waits is False and unit.silent > MAX_OF_UNIT:
            return [*self._take(self._of_unit(number)), one]
        self.open.append(one)
        if len(of_unit := self._of_unit(number)) > MAX_OF_UNIT:
            return self._take(of_unit[:1])
        return self._take(self.open[:1]) if len(self.open) > MAX_OPEN else []

    def put_back(self, request: Adu) -> None:
        """Add a request whose response turned out to belong to an earlier request."""
        self.open.append(OpenLineRequest(request, 0, 0, waits=False))
        self.open.sort(key=lambda one: one.adu.end_ns)

    def fitting(self, response: Adu) -> list[OpenLineRequest]:
        """Return the requests that a response fits in its form, and in its time if that is known.

        If the response fits none in its time, returns the last one that it fits in its form.
        """
        found = [one for one in self.open if fits(one.adu, response)]
        start_ns = response.start_ns
        in_time = [one for one in found if self.can_take(response.unit, start_ns - one.adu.end_ns)]
        return in_time or found[-1:]

    def take(self, one: OpenLineRequest) -> list[OpenLineRequest]:
        """Take out a request that got its response; return the unit's requests before it.

        These no longer stay open, as a slave answers in order.
        """
        of_unit = self._of_unit(one.adu.unit)
        taken = self._take(of_unit[: of_unit.index(one) + 1])
        return taken[:-1]

    def take_all_of(self, unit: int) -> list[OpenLineRequest]:
        """Take out the requests to a unit that answered a later request."""
        return self._take(self._of_unit(unit)) if self.open else []

    def take_sent_before(self, time_ns: int) -> list[OpenLineRequest]:
        """Take out the requests that ended before `time_ns`."""
        return self._take([one for one in self.open if one.adu.end_ns < time_ns])

    def take_all(self) -> list[OpenLineRequest]:
        taken, self.open = self.open, []
        return taken

    def note_heard(self, number: int) -> None:
        """Note that a unit has sent a response that belongs to no request."""
        self._of(number).silent = 0

    def note_response(self, number: int, taken_ns: int) -> None:
        """Note the time (ns) that a unit took to respond."""
        unit = self._units.get(number)
        if unit is None:
            unit = self._of(number)
        unit.silent = 0
        unit.number += 1
        if taken_ns > unit.slowest_ns:
            unit.slowest_ns = taken_ns
        if taken_ns < unit.fastest_ns:
            unit.fastest_ns = taken_ns

    def is_too_early(self, unit: int, taken_ns: int) -> bool:
        """True if a unit never responded in less than twice `taken_ns`.

        An adapter that delivers in blocks makes times shorter or longer by up to BLOCK_NS.
        """
        times = self._of(unit)
        is_known = times.number >= ENOUGH_TIMES
        return is_known and max(2 * taken_ns, taken_ns + BLOCK_NS) < times.fastest_ns

    def can_take(self, unit: int, taken_ns: int) -> bool:
        """True if a unit may take `taken_ns` to respond, as far as its times are known."""
        times = self._of(unit)
        return times.number < ENOUGH_TIMES or taken_ns <= UNUSUAL * times.slowest_ns

    def _of(self, unit: int) -> _Unit:
        found = self._units.get(unit)
        if found is None:
            found = self._units[unit] = _Unit()
        return found

    def _of_unit(self, unit: int) -> list[OpenLineRequest]:
        return [one for one in self.open if one.adu.unit == unit]

    def _take(self, some: list[OpenLineRequest]) -> list[OpenLineRequest]:
        if some:
            self.open = [one for one in self.open if one not in some]
        return some


def has_code(request: Adu, response: Adu) -> bool:
    """True if a response, or exception response, has the unit and the function of a request."""
    return request.unit == response.unit and is_response_code(request.pdu[0], response.pdu[0])


def fits(request: Adu, response: Adu) -> bool:
    """True if a response has the unit of a request and the form that the request asks for."""
    if request.unit != response.unit:
        return False
    expected = ExpectedResponse.of(request.pdu)
    return expected is not None and expected.fits(response.pdu)
