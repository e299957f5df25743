"""Evidence to decode: the bytes of a serial line, of a relay, and of capture files."""

from __future__ import annotations

from typing import TYPE_CHECKING

from mbtool.core import (
    Chunk,
    Connection,
    Direction,
    Endpoint,
    Quiet,
    SerialFormat,
    SerialLink,
    Stamp,
)
from mbtool.decode.decoder import Decoder
from mbtool.devices import Namer
from mbtool.logs import LogWriter
from mbtool.logs.layout import Opcode
from mbtool.modbus import mbap_adu, rtu_adu
from tests.logs.samples import changed, records_of
from tests.packets.building import Talk, pcap

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence
    from pathlib import Path

    from mbtool.core import Packet
    from mbtool.decode.decoder import Evidence, Record

START_NS = 1_700_000_000_000_000_000
MS = 1_000_000

LINE = SerialLink("/dev/rs485", SerialFormat())

READ = bytes.fromhex("03 0000 0002")  # read holding registers, address 0, quantity 2
VALUES = bytes.fromhex("03 04 1234 5678")  # four bytes, two registers
WRITE = bytes.fromhex("06 0010 0007")  # write single register, address 16, value 7
ONE = bytes.fromhex("03 02 0001")  # two bytes, one register with the value 1
REFUSED = bytes.fromhex("83 02")  # exception response to 03, illegal data address

CONNECTION = Connection(Endpoint("10.0.0.1", 50211), Endpoint("10.0.0.9", 502), 1)


def heard(at_ms: int, pdu: bytes, unit: int = 1, link: str = LINE.name) -> Chunk:
    """An RTU frame that one read of a serial port brought, complete at a time."""
    return Chunk(ts_ns=START_NS + at_ms * MS, link=link, data=rtu_adu(unit, pdu))


def exchange(at_ms: int, request: bytes = READ, response: bytes = VALUES) -> list[Chunk]:
    """A request on the serial line and its response 20 ms later."""
    return [heard(at_ms, request), heard(at_ms + 20, response)]


def relayed(
    at_ms: float,
    direction: Direction,
    pdu: bytes,
    *,
    number: int = 1,
    connection: Connection = CONNECTION,
) -> Chunk:
    """A Modbus/TCP ADU that a tap passed on."""
    return Chunk(
        ts_ns=START_NS + round(at_ms * MS),
        link=connection.link,
        data=mbap_adu(number, 1, pdu),
        direction=direction,
        stamp=Stamp.AT_ONCE,
        connection=connection,
    )


def captured(exchanges: int = 3) -> list[Packet]:
    """The packets of a TCP connection with so many reads of holding registers."""
    return _connection([(READ, VALUES)] * exchanges)


def read(address: int, values: Sequence[int]) -> tuple[bytes, bytes]:
    """A read of these holding registers and its response, as PDUs."""
    count = len(values)
    request = b"\x03" + address.to_bytes(2, "big") + count.to_bytes(2, "big")
    data = b"".join(value.to_bytes(2, "big") for value in values)
    return request, bytes((0x03, 2 * count)) + data


def capture_of(exchanges: Sequence[tuple[bytes, bytes]]) -> bytes:
    """A pcap file with one TCP connection: requests, each with its response."""
    return pcap(_connection(exchanges))


def _connection(exchanges: Sequence[tuple[bytes, bytes]]) -> list[Packet]:
    talk = Talk()
    packets = talk.handshake()
    for number, (request, response) in enumerate(exchanges):
        packets.append(talk.request(mbap_adu(number, 1, request)))
        packets.append(talk.response(mbap_adu(number, 1, response)))
    return [*packets, *talk.goodbye()]


def capture_file(exchanges: int = 3) -> bytes:
    """The same as a pcap file."""
    return pcap(captured(exchanges))


def damaged_log(path: Path, number: int) -> Path:
    """A log of three reads on a serial line, each in a chunk of its own, one of them damaged."""
    return damaged(path, [exchange(1000 * second) for second in range(3)], number)


def damaged(path: Path, flushes: Sequence[Sequence[Chunk]], number: int) -> Path:
    """A log of what was heard and decoded, a chunk of the file for each flush, one damaged."""
    decoder = Decoder(Namer(), lines={LINE.name: LINE})
    with LogWriter(path, capture={}) as log:
        log.add_link(LINE.name, {"spec": str(LINE)})
        for second, chunks in enumerate(flushes, 1):
            items: list[Evidence] = [*chunks, Quiet(chunks[-1].ts_ns + 100 * MS, LINE.name)]
            for item in items:
                if isinstance(item, Chunk):
                    log.write(item)
                for record in decoder.feed(item):
                    log.write(record)
            log.tick(second * 1_000_000_000)
    data = path.read_bytes()
    offset, size = records_of(data, Opcode.CHUNK)[number]
    path.write_bytes(changed(data, offset + 9 + size - 20))
    return path


def polling_log(path: Path, latencies_ms: Mapping[int, float], polls: int = 30) -> Path:
    """A log of a tap: reads of one holding register at each address, with these median latencies.

    The latencies of a request vary by 4 % around the median.
    """
    decoder = Decoder(Namer())
    with LogWriter(path, capture={}) as log:
        for number in range(polls):
            for place, (address, median_ms) in enumerate(sorted(latencies_ms.items())):
                at_ms = number * 1000 + place * 100
                late_ms = median_ms * (1 + (number % 5 - 2) / 50)
                read = bytes([3, *address.to_bytes(2, "big"), 0, 1])
                for chunk in (
                    relayed(at_ms, Direction.REQUEST, read, number=at_ms & 0xFFFF),
                    relayed(at_ms + late_ms, Direction.RESPONSE, ONE, number=at_ms & 0xFFFF),
                ):
                    log.write(chunk)
                    for record in decoder.feed(chunk):
                        log.write(record)
    return path


def of_link(records: Iterable[Record], link: str) -> list[Record]:
    return [record for record in records if record.link == link]
