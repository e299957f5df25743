"""Items to write to a log, as hypothesis strategies and as a few that speak for all."""

from __future__ import annotations

import io
from typing import TYPE_CHECKING, Any

from hypothesis import strategies as st
from mcap.reader import make_reader

from mbtool.core import Chunk, Connection, Direction, Endpoint, EventKind, Packet, Stamp, WireEvent
from mbtool.devices import NamedTransaction, PointValue
from mbtool.logs.layout import RECORD_HEAD, Opcode
from mbtool.logs.records import RecordStream
from mbtool.logs.writer import LogWriter
from mbtool.modbus import Outcome, Transport, Verdict
from mbtool.modbus.adu import DirectionBy

if TYPE_CHECKING:
    from collections.abc import Iterable
    from pathlib import Path

    from mbtool.logs.messages import DecodingMark, LogItem

START_NS = 1_700_000_000_000_000_000

READ_REQUEST = bytes.fromhex(
    "01"  # unit
    "03 0000 0002"  # read holding registers, address 0, quantity 2
    "c4 0b"  # CRC
)
READ_RESPONSE = bytes.fromhex(
    "01"  # unit
    "03 04 1234 5678"  # read holding registers, four bytes
    "81 07"  # CRC
)


def transaction(number: int = 0, **fields: Any) -> NamedTransaction:
    """A read that went well, `number` milliseconds after START_NS."""
    request_ns = START_NS + number * 1_000_000
    defaults: dict[str, Any] = {
        "link": "rs485",
        "transport": Transport.RTU,
        "unit": 1,
        "function": 3,
        "function_name": "read holding registers",
        "address": 0,
        "quantity": 2,
        "response_values": [0x1234, 0x5678],
        "outcome": Outcome.OK,
        "request_ns": request_ns,
        "response_ns": request_ns + 500_000,
        "latency_ns": 400_000,
        "retries": 0,
        "request_raw": READ_REQUEST,
        "response_raw": READ_RESPONSE,
        "direction_by": DirectionBy.PENDING,
        "confidence": 0.9,
    }
    return NamedTransaction(**{**defaults, **fields})


def chunk(number: int = 0, data: bytes = READ_REQUEST) -> Chunk:
    return Chunk(ts_ns=START_NS + number * 1_000_000, link="rs485", data=data)


EVENT = WireEvent(
    ts_ns=START_NS + 1,
    link="10.0.0.9",
    kind=EventKind.GAP,
    message="60 bytes are missing",
    source="10.0.0.1:50211",
    destination="10.0.0.9:502",
    missing=60,
)

PACKET = Packet(
    ts_ns=START_NS + 2, link="eth0", link_type=1, data=bytes(range(60)), original_length=1514
)

SEGMENT = Chunk(
    ts_ns=START_NS + 3,
    link="10.0.0.9",
    data=b"\x00\x01",
    direction=Direction.RESPONSE,
    stamp=Stamp.AT_ONCE,
    connection=Connection(Endpoint("10.0.0.1", 50211), Endpoint("10.0.0.9", 502), 7),
)

NAMED = transaction(
    5,
    verdicts=[Verdict.GLUED],
    device="idec-ft1a-touch",
    reference="HR400001..400002",
    points=[
        PointValue(name="HR400001", reference="HR400001", value=4660.0, text="4660"),
        PointValue(name="level", reference="HR400002", value=2.5, text="2.5 m", unit="m"),
        PointValue(name="flow", reference="HR400003", text="not a number"),
        PointValue(name="valve", reference="HR400004", value=1, text="open", written=True),
    ],
    findings=["FT1A-Q3"],
)

ONE_OF_EACH: tuple[LogItem, ...] = (chunk(), transaction(), EVENT, PACKET, SEGMENT, NAMED)


def write_log(path: Path, items: Iterable[LogItem | DecodingMark]) -> Path:
    """A closed log of these items, with a link and a profile."""
    with LogWriter(path, capture={"host": "bench"}) as log:
        log.add_link("rs485", {"spec": "rtu:/dev/ttyUSB0@19200-8E1"})
        log.add_profile("idec-ft1a-touch", b'{"name": "idec-ft1a-touch"}')
        for item in items:
            log.write(item)
    return path


def records_of(data: bytes, opcode: Opcode) -> list[tuple[int, int]]:
    """Where the records of a kind begin, and how long their content is."""
    stream = RecordStream(io.BytesIO(data), "x.mcap")
    stream.read_magic()
    found = []
    while (record := stream.look_at_record()) and record.opcode != Opcode.DATA_END:
        if record.opcode == opcode:
            found.append((record.offset, len(record.content)))
        stream.take(RECORD_HEAD.size + len(record.content))
    return found


def changed(data: bytes, at: int) -> bytes:
    """The same with one bit of a byte changed."""
    return data[:at] + bytes([data[at] ^ 0x40]) + data[at + 1 :]


def stock_messages(path: Path) -> list[tuple[str, str, bytes]]:
    """Topic, schema name and data of all messages, by the stock reader with CRC validation."""
    with path.open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True)
        return [
            (channel.topic, schema.name if schema is not None else "", message.data)
            for schema, channel, message in reader.iter_messages()
        ]


_times = st.integers(0, 2**63)
_names = st.text(st.characters(exclude_categories=["Cs"]), max_size=12)
_raw = st.binary(max_size=40)
_maybe_byte = st.none() | st.integers(0, 255)
_maybe_word = st.none() | st.integers(0, 65535)
_maybe_ns = st.none() | st.integers(0, 2**63 - 1)
_values = st.none() | st.lists(st.integers(0, 65535), max_size=5)
_endpoints = st.builds(Endpoint, _names, st.integers(0, 65535))
_connections = st.builds(Connection, _endpoints, _endpoints, st.integers(0, 2**31))

chunks = st.builds(
    Chunk,
    ts_ns=_times,
    link=_names,
    data=_raw,
    direction=st.sampled_from(Direction),
    stamp=st.sampled_from(Stamp),
    connection=st.none() | _connections,
)
reads = st.builds(
    Chunk,
    ts_ns=st.integers(0, 1000) | _times,
    link=st.sampled_from(["a", "b"]),
    data=_raw,
    direction=st.sampled_from(Direction),
)
packets = st.builds(
    Packet,
    ts_ns=_times,
    link=_names,
    link_type=st.integers(0, 65535),
    data=_raw,
    original_length=st.integers(0, 2**32 - 1),
)
events = st.builds(
    WireEvent,
    ts_ns=_times,
    link=_names,
    kind=st.sampled_from(EventKind),
    message=_names,
    source=_names,
    destination=_names,
    raw=_raw,
    missing=st.integers(0, 2**63),
    packets=st.integers(0, 2**63),
)
points = st.builds(
    PointValue,
    name=_names,
    reference=_names,
    value=st.none() | st.floats(allow_nan=False, allow_infinity=False),
    text=_names,
    unit=st.none() | _names,
)
transactions = st.builds(
    NamedTransaction,
    link=_names,
    transport=st.sampled_from(Transport),
    source=st.none() | _names,
    destination=st.none() | _names,
    unit=st.integers(0, 255),
    transaction_id=_maybe_word,
    function=st.integers(0, 127),
    function_name=_names,
    sub_function=_maybe_word,
    address=_maybe_word,
    quantity=_maybe_word,
    write_address=_maybe_word,
    request_values=_values,
    response_values=_values,
    exception=_maybe_byte,
    exception_name=st.none() | _names,
    outcome=st.sampled_from(Outcome),
    request_ns=_maybe_ns,
    response_ns=_maybe_ns,
    latency_ns=_maybe_ns,
    retries=st.integers(0, 1000),
    request_raw=st.none() | _raw,
    response_raw=st.none() | _raw,
    verdicts=st.lists(st.sampled_from(Verdict), max_size=3),
    direction_by=st.sampled_from(DirectionBy),
    confidence=st.floats(0, 1),
    device=st.none() | _names,
    reference=st.none() | _names,
    points=st.lists(points, max_size=3),
    findings=st.lists(_names, max_size=2),
)
items = st.one_of(chunks, packets, events, transactions)
