"""A request of a TCP connection that waits for its response, or that the capture lacks."""

from __future__ import annotations

import msgspec

from mbtool.core import Direction
from mbtool.decode.stream_progress import AduPlace
from mbtool.modbus.adu import Adu, Transport
from mbtool.modbus.expected_response import (
    UNKNOWN_SIZE,
    ExpectedResponse,
    is_response_code,
    is_response_to,
)
from mbtool.modbus.pdu import parse_pdu

SMALLEST_RESPONSE = 9
"""Bytes of the shortest response over Modbus/TCP: an exception response."""

_EXCEPTION_PDU = 2
"""The size in bytes of the PDU of an exception response."""
_ADDED_BYTES = {Transport.TCP: 7, Transport.RTU_TCP: 3}
"""By transport, the number of bytes that an ADU has besides its PDU."""


class OpenRequest(msgspec.Struct, gc=False, eq=False, kw_only=True):
    """A request whose response has not arrived."""

    number: int
    """The number of the request, counted from 1 in its connection."""
    since_ns: int
    """The time (ns) of the request's last byte; if the capture lacks the request, the time at which
    the loss was noticed."""
    adu: Adu | None
    """The request's ADU; None if the capture lacks the request."""
    place: AduPlace | None = None
    is_pipelined: bool = False
    """True if the master sent this request while other requests waited for their responses."""
    exists: bool = True
    """False if the capture lacks this request and the number of lost bytes does not prove that it
    was sent: 30 lost bytes may be one request or two."""
    may_not_exist: bool = False
    """True if the capture lacks this request and it is doubtful that it was ever sent."""
    may_be_lost: bool = False
    """True if the capture lacks bytes that may have been the response to this request."""
    may_be_answered: bool = False
    """True if a response that is paired with another request, or with one that the capture lacks,
    may as well be the response to this one."""
    repeats_lost_id: bool = False
    """True if ids count up, the capture lacks a request before this one, and no id is missing for
    it. The lost request may then have had the id of this one."""
    next_ns: int | None = None
    """The time (ns) at which the next request was complete; None while there is none."""
    is_repeated: bool = False
    """True if the next request has the same unit and PDU."""
    counts: bool = True
    """False if a later equal request has already counted this one in its `retries`, or if the
    capture lacks bytes of this request."""

    @property
    def transaction_id(self) -> int | None:
        return None if self.adu is None else self.adu.transaction_id

    @property
    def function(self) -> int | None:
        return None if self.adu is None else self.adu.pdu[0]

    def can_get(
        self, response: Adu, place: AduPlace | None, *, with_other_unit: bool = False
    ) -> bool:
        """True if `response`, which stands at `place`, can answer this request.

        False if its unit or function differ, if its sender had not received this request, or if the
        master had received the response before it sent this request. `with_other_unit` allows
        another unit.
        """
        request = self.adu
        if request is not None and not (
            (with_other_unit or request.unit == response.unit)
            and is_response_code(request.pdu[0], response.pdu[0])
        ):
            return False
        if place is None or self.place is None:
            return True
        if place.acknowledged is not None and place.acknowledged < self.place.end:
            return False
        received = self.place.acknowledged
        return received is None or received < place.end

    def fits(self, response: Adu) -> bool:
        """True if a response has the length, and repeats the fields, that this request demands."""
        if self.adu is None or self.adu.missing:
            return True  # The capture lacks bytes of the request: any form is possible.
        expected = ExpectedResponse.of(self.adu.pdu)  # Cached, so faster than parse_pdu below.
        if response.missing:
            size = response.size - _ADDED_BYTES[response.transport.over_tcp]
            return expected is not None and expected.fits_start(response.pdu, size)
        if expected is not None and expected.fits(response.pdu):
            return True
        return is_response_to(parse_pdu(self.adu.pdu, Direction.REQUEST), response.pdu)

    def is_next_to(self, response: Adu, place: AduPlace | None) -> bool:
        """True if acknowledgements show that no byte was sent between this request and `response`.

        False if a position is unknown, as when `place` is None.
        """
        if place is None or self.place is None:
            return False
        start = place.end - response.size
        return place.acknowledged == self.place.end and self.place.acknowledged == start

    def response_sizes(self) -> tuple[int, ...]:
        """The lengths, in bytes, that the response's ADU can have; empty if unknown."""
        if self.adu is None or self.adu.missing:
            return ()
        added = _ADDED_BYTES[self.adu.transport.over_tcp]
        expected = ExpectedResponse.of(self.adu.pdu)
        if expected is None or expected.size == UNKNOWN_SIZE:
            return ()
        return expected.size + added, _EXCEPTION_PDU + added
