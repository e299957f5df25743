"""Evidence to decode: the bytes of a serial line, of a relay, and of capture files."""

from __future__ import annotations

from typing import TYPE_CHECKING

from mbtool.core import Chunk, Connection, Direction, Endpoint, SerialFormat, SerialLink, Stamp
from mbtool.modbus import mbap_adu, rtu_adu
from tests.packets.building import Talk, pcap

if TYPE_CHECKING:
    from collections.abc import Iterable

    from mbtool.core import Packet
    from mbtool.workflows.decoding import Record

START_NS = 1_700_000_000_000_000_000
MS = 1_000_000

LINE = SerialLink("/dev/rs485", SerialFormat())

READ = bytes.fromhex("03 0000 0002")  # read holding registers, address 0, quantity 2
VALUES = bytes.fromhex("03 04 1234 5678")  # four bytes, two registers
WRITE = bytes.fromhex("06 0010 0007")  # write single register, address 16, value 7
REFUSED = bytes.fromhex("83 02")  # exception response to 03, illegal data address

CONNECTION = Connection(Endpoint("10.0.0.1", 50211), Endpoint("10.0.0.9", 502), 1)


def heard(at_ms: int, pdu: bytes, unit: int = 1, link: str = LINE.name) -> Chunk:
    """An RTU frame that one read of a serial port brought, complete at a time."""
    return Chunk(ts_ns=START_NS + at_ms * MS, link=link, data=rtu_adu(unit, pdu))


def exchange(at_ms: int, request: bytes = READ, response: bytes = VALUES) -> list[Chunk]:
    """A request on the serial line and its response 20 ms later."""
    return [heard(at_ms, request), heard(at_ms + 20, response)]


def relayed(
    at_ms: int,
    direction: Direction,
    pdu: bytes,
    *,
    number: int = 1,
    connection: Connection = CONNECTION,
) -> Chunk:
    """A Modbus/TCP ADU that a tap passed on."""
    return Chunk(
        ts_ns=START_NS + at_ms * MS,
        link=connection.link,
        data=mbap_adu(number, 1, pdu),
        direction=direction,
        stamp=Stamp.AT_ONCE,
        connection=connection,
    )


def captured(exchanges: int = 3) -> list[Packet]:
    """The packets of a TCP connection with so many reads of holding registers."""
    talk = Talk()
    packets = talk.handshake()
    for number in range(exchanges):
        packets.append(talk.request(mbap_adu(number, 1, READ)))
        packets.append(talk.response(mbap_adu(number, 1, VALUES)))
    return [*packets, *talk.goodbye()]


def capture_file(exchanges: int = 3) -> bytes:
    """The same as a pcap file."""
    return pcap(captured(exchanges))


def of_link(records: Iterable[Record], link: str) -> list[Record]:
    return [record for record in records if record.link == link]
