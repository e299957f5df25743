"""What Wireshark reads from the pipe while a line is heard."""

from __future__ import annotations

import io
from typing import TYPE_CHECKING

from mbtool.core import EventKind, Quiet, WireEvent
from mbtool.decode.decoder import Decoder
from mbtool.devices import Assignments, Namer, parse_assignment
from mbtool.packets.line_packets import RAW_IPV4, RTAC_SERIAL, LinePacket
from mbtool.sources.files import open_capture
from mbtool.workflows.extcap import LivePackets
from mbtool.workflows.shared.reading import Reading, ReadingOptions
from tests.workflows.evidence import LINE, MS, READ, REFUSED, VALUES, WRITE, exchange, heard

if TYPE_CHECKING:
    from pathlib import Path

    from mbtool.core import Chunk
    from mbtool.decode.decoder import Record

TOUCH = Assignments([parse_assignment("all=idec-ft1a-touch")])


class _Pipe(io.BytesIO):
    """Counts how often what was written was passed on."""

    flushed = 0

    def flush(self) -> None:
        super().flush()
        self.flushed += 1


def _records(chunks: list[Chunk], assignments: Assignments) -> list[Record]:
    decoder = Decoder(Namer(assignments), lines={LINE.name: LINE})
    records = [record for chunk in chunks for record in decoder.feed(chunk)]
    records += decoder.feed(Quiet(chunks[-1].ts_ns + 2000 * MS, LINE.name))
    return [*records, *decoder.close()]


def _written(records: list[Record], assignments: Assignments) -> _Pipe:
    pipe = _Pipe()
    live = LivePackets(pipe, LINE, assignments)
    for record in records:
        live.write(record)
    return pipe


def test_frames_become_packets_that_decode_as_the_line(tmp_path: Path) -> None:
    chunks = [
        *exchange(0),
        *exchange(100, READ, REFUSED),
        heard(200, READ),
        *exchange(300, WRITE, WRITE),
    ]
    records = _records(chunks, TOUCH)
    path = tmp_path / "live.pcapng"
    path.write_bytes(_written(records, TOUCH).getvalue())
    again = list(Reading([str(path)], ReadingOptions()).records())
    assert [_facts(one) for one in again] == [_facts(one) for one in records]
    assert {one.device for one in again if not isinstance(one, WireEvent)} == {"idec-ft1a-touch"}


def _facts(one: Record) -> tuple[object, ...]:
    assert not isinstance(one, WireEvent)
    return one.unit, one.outcome, one.request_raw, one.response_raw, one.request_ns, one.findings


def test_each_record_is_passed_on_at_once() -> None:
    records = _records([*exchange(0), *exchange(100)], Assignments())
    pipe = _written(records, Assignments())
    assert len(records) == 2
    assert pipe.flushed == 1 + len(records)


def test_bytes_that_are_no_frame_are_packets_of_another_interface(tmp_path: Path) -> None:
    noise = heard(50, VALUES).data[:-1] + b"\0"
    chunks = [*exchange(0), exchange(0)[0]]
    chunks[2] = type(chunks[2])(ts_ns=chunks[1].ts_ns + 100 * MS, link=LINE.name, data=noise)
    records = _records(chunks, Assignments())
    assert any(isinstance(one, WireEvent) for one in records)
    path = tmp_path / "live.pcapng"
    path.write_bytes(_written(records, Assignments()).getvalue())
    with open_capture(str(path)) as capture:
        packets = list(capture.packets())
    assert [one.link_type for one in packets] == [RAW_IPV4, RAW_IPV4, RTAC_SERIAL]
    assert all(isinstance(one, LinePacket) for one in packets)
    assert packets[2].data.endswith(noise)


def test_an_event_without_bytes_is_no_packet() -> None:
    event = WireEvent(ts_ns=0, link=LINE.name, kind=EventKind.LINE_ERROR, message="parity")
    assert _written([event], Assignments()).getvalue() == _written([], Assignments()).getvalue()
