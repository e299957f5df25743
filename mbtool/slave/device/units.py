"""Whom a request is for: several slaves on one line, or behind one endpoint."""

# A responder is one device and answers whatever unit it is asked as. Units stands before it and
# knows what a unit means where it is played:
#
#     serial line   unit 0 is a broadcast: every slave executes it, none answers (Serial Line V1.02,
#                   2.1); a unit that no slave here has is another's, so silence
#     TCP           unit 0 is a unit like any other; a device that answers any unit (FA3) gets all
#                   that name no other; the rest is silence
#
# RTU over TCP is a serial line at the end of a cable, so it follows the serial line's rules.

from __future__ import annotations

from typing import TYPE_CHECKING

from mbtool.core import SerialLink, TcpLink

if TYPE_CHECKING:
    from collections.abc import Mapping

    from mbtool.devices import Profile
    from mbtool.modbus.response import Responder, Response

BROADCAST_UNIT = 0


class Units:
    """Passes each request to the slave it is for."""

    def __init__(
        self,
        slaves: Mapping[int, Responder],
        *,
        any_unit: Responder | None = None,
        broadcast: bool = False,
    ) -> None:
        """`any_unit` gets what no slave is for; `broadcast`: unit 0 means all slaves."""
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
    """A device on a link, under a unit and by the rules of that link, and others beside it.

    Where it answers any unit, it gets those that are no other's.
    """
    serial = is_line(link)
    any_unit = device if profile.any_unit and not serial else None
    return Units({**(others or {}), unit: device}, any_unit=any_unit, broadcast=serial)


def is_line(link: SerialLink | TcpLink) -> bool:
    """Whether a link has the rules of a serial line."""
    return isinstance(link, SerialLink) or link.rtu
