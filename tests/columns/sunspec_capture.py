"""Makes captures of a SunSpec device."""

from __future__ import annotations

from mbtool.core import Direction
from mbtool.modbus import encode_pdu
from tests.columns.test_equality import poll
from tests.devices.sunspec import BASE, registers
from tests.packets.building import Talk, pcap

_READ = 20


def sunspec_capture(before: int) -> bytes:
    """A slave is asked for its map once, behind so many other polls; more polls follow.

    The first polls of a connection are decoded one by one, later ones are read as arrays.
    """
    talk = Talk()
    packets = talk.handshake()
    words = [word for block in registers().values() for word in block] + [0] * _READ
    for turn in range(60):
        at = (turn - before) * _READ
        is_map = 0 <= at < 3 * _READ
        address = BASE + at if is_map else 7
        values = tuple(words[at : at + _READ]) if is_map else tuple(range(_READ))
        request = encode_pdu(0x03, Direction.REQUEST, address=address, quantity=_READ)
        packets += poll(talk, 1, request, encode_pdu(0x03, Direction.RESPONSE, values=values))
    return pcap(packets)
