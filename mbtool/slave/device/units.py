"""Passes each request to the right slave, where several slaves share a serial line or endpoint."""

# A responder is one device and answers requests for any unit. Units selects the responder for each
# request, by the rules of the link:
#
#     serial line   unit 0 is a broadcast: every slave executes it and none answers (Serial Line
#                   V1.02, 2.1). A unit that no slave here has belongs to another slave: silence.
#     TCP           unit 0 is a unit like any other. A device that answers any unit (FA3) gets the
#                   requests for units that no other slave has. All others get silence.
#
# RTU over TCP follows the rules of a serial line.

from __future__ import annotations

from typing import TYPE_CHECKING

from mbtool.core import SerialLink, TcpLink

if TYPE_CHECKING:
    from collections.abc import Mapping

    from mbtool.devices import Profile
    from mbtool.modbus.response import Responder, Response

BROADCAST_UNIT = 0


class Units:
    """Passes each request to the slave with the request's unit number; is itself a responder."""

    def __init__(
        self,
        slaves: Mapping[int, Responder],
        *,
        any_unit: Responder | None = None,
        broadcast: bool = False,
    ) -> None:
        """Take the slaves by unit number.

        `any_unit` answers requests for units that `slaves` does not have; None for no response. If
        `broadcast` is true, all slaves execute a request for unit 0, and none answers.
        """
        self._slaves = dict(slaves)
        self._any_unit = any_unit
        self._broadcast = broadcast

    def respond(self, unit: int, pdu: bytes, now_ns: int) -> Response | None:
        if self._broadcast and unit == BROADCAST_UNIT:
            for each in self._slaves.values():
                each.respond(unit, pdu, now_ns)
            return None
        slave = self._slaves.get(unit) or self._any_unit
        return slave.respond(unit, pdu, now_ns) if slave is not None else None


def units_on(
    link: SerialLink | TcpLink,
    profile: Profile,
    unit: int,
    device: Responder,
    others: Mapping[int, Responder] | None = None,
) -> Units:
    """Return a responder for a device with the number `unit` and other slaves on the same link.

    `others` has those other slaves by unit; None if there are none. Requests are passed on by the
    rules of the link (see the top of this file). A device whose
    profile says that it answers any unit gets the requests for units that no other slave has.
    """
    serial = is_line(link)
    any_unit = device if profile.any_unit and not serial else None
    return Units({**(others or {}), unit: device}, any_unit=any_unit, broadcast=serial)


def is_line(link: SerialLink | TcpLink) -> bool:
    """True for a link that follows the rules of a serial line: serial, or RTU over TCP."""
    return isinstance(link, SerialLink) or link.rtu
