"""Captures and logs converted into each other, and back."""

from __future__ import annotations

from dataclasses import replace
from operator import attrgetter
from pathlib import Path
from typing import TYPE_CHECKING

import msgspec
import pytest

from mbtool.core import (
    Chunk,
    Direction,
    EventKind,
    InputError,
    SerialFormat,
    SerialLink,
    UsageError,
    WireEvent,
)
from mbtool.devices import NamedTransaction
from mbtool.logs import LogReader, LogWriter, RotatingLog, Rotation, transaction_to_jsonl
from mbtool.logs.links import SPEC
from mbtool.modbus import rtu_adu
from mbtool.modbus.response import DamagedAnswers
from mbtool.query.where import parse_where
from mbtool.workflows.anonymise import anonymous_conversion
from mbtool.workflows.convert import Conversion
from mbtool.workflows.shared.anonymous_packets import AnonymousChoice
from mbtool.workflows.shared.pcapng_output import Converted
from mbtool.workflows.shared.reading import Reading, ReadingOptions
from mbtool.workflows.shared.time_window import TimeWindow
from tests.captures import read_packets
from tests.records import without_origins
from tests.workflows import sick_line as sick
from tests.workflows.evidence import LINE, READ, VALUES, captured, exchange, relayed

if TYPE_CHECKING:
    from collections.abc import Iterable

    from mbtool.decode.decoder import Record

CAPTURES = Path(__file__).resolve().parents[2] / "captures"
LOGS = sorted(CAPTURES.glob("*.mcap"))
PACKETS = sorted(CAPTURES.glob("*.pcap*"))
"""Packets, beside the lines that they decode to."""
PACKETS = [one for one in PACKETS if one.suffix != ".jsonl"]


def _convert(
    paths: Iterable[Path],
    out: Path,
    *,
    start: str | None = None,
    end: str | None = None,
    where: str | None = None,
) -> Converted:
    window = TimeWindow.parse(start, end)
    fits = None if where is None else parse_where(where)
    return Conversion([str(one) for one in paths], ReadingOptions(), window, fits).write(str(out))


def _transactions(path: Path, *, raw: bool = True) -> list[Record]:
    records = Reading([str(path)], ReadingOptions(raw=raw)).records()
    return without_origins(one for one in records if not isinstance(one, WireEvent))


def _log(path: Path, items: Iterable[Chunk], link: SerialLink = LINE) -> Path:
    with LogWriter(path, capture={}) as log:
        log.add_link(link.name, {SPEC: str(link)})
        for item in items:
            log.write(item)
    return path


def _evidence(path: Path) -> list[object]:
    with LogReader.open(path) as log:
        return list(log.evidence())


@pytest.mark.parametrize("path", LOGS, ids=lambda path: path.stem)
def test_a_log_comes_back_from_pcapng_with_its_evidence_and_transactions(
    path: Path, tmp_path: Path
) -> None:
    shown, back = tmp_path / "shown.pcapng", tmp_path / "back.mcap"
    _convert([path], shown)
    _convert([shown], back)
    assert _evidence(back) == _evidence(path)
    expected = _transactions(path)
    assert expected
    assert _transactions(shown) == _transactions(back) == expected
    assert _transactions(back, raw=False) == expected


@pytest.mark.parametrize("path", PACKETS, ids=lambda path: path.suffix)
@pytest.mark.parametrize(
    "way", [(".pcapng",), (".pcap",), (".mcap", ".pcapng"), (".mcap", ".pcap")]
)
def test_packets_come_back_as_they_were_captured(
    path: Path, way: tuple[str, ...], tmp_path: Path
) -> None:
    source = path
    for number, suffix in enumerate(way):
        out = tmp_path / f"{number}{suffix}"
        _convert([source], out)
        source = out
    before, after = list(read_packets(path)), list(read_packets(source))
    assert [one.data for one in after] == [one.data for one in before]
    assert [(one.ts_ns, one.original_length, one.link_type) for one in after] == [
        (one.ts_ns, one.original_length, one.link_type) for one in before
    ]
    assert _transactions(source) == _transactions(path)


def test_two_taps_of_one_line_come_back(tmp_path: Path) -> None:
    link = SerialLink("/dev/a", SerialFormat(), False, "/dev/b")
    sides = Direction.REQUEST, Direction.RESPONSE
    chunks = [
        replace(chunk, link=link.name, direction=side)
        for number in range(4)
        for chunk, side in zip(exchange(100 * number), sides, strict=True)
    ]
    path = _log(tmp_path / "taps.mcap", chunks, link)
    _convert([path], tmp_path / "shown.pcapng")
    assert [one.outcome for one in _transactions(path)] == ["ok"] * 4  # type: ignore[union-attr]
    assert _transactions(tmp_path / "shown.pcapng") == _transactions(path)


def test_bytes_that_are_no_frame_are_on_an_interface_of_their_own(tmp_path: Path) -> None:
    _convert([CAPTURES / "torn-and-glued-frames.mcap"], tmp_path / "x.pcapng")
    packets = list(read_packets(tmp_path / "x.pcapng"))
    assert {one.link_type for one in packets} == {228, 250}
    noise = [one.data[12:] for one in packets if one.link_type == 250]
    assert [len(one) for one in noise] == [2, 1, 9]


def test_captures_become_one_in_the_order_of_time(tmp_path: Path) -> None:
    early = _log(tmp_path / "b.mcap", exchange(0))
    packets = tmp_path / "p.mcap"
    with LogWriter(packets, capture={}) as log:
        for packet in captured(2):
            log.write(packet)
    late = _log(tmp_path / "a.mcap", exchange(60_000))
    for suffix in (".mcap", ".pcapng"):
        out = tmp_path / f"all{suffix}"
        _convert([late, packets, early], out)
        assert len(_transactions(out)) == sum(
            len(_transactions(one)) for one in (early, packets, late)
        )
    times = [one.ts_ns for one in _evidence(tmp_path / "all.mcap")]  # type: ignore[attr-defined]
    assert times == sorted(times)


def test_one_line_heard_twice_at_once_is_refused(tmp_path: Path) -> None:
    one = _log(tmp_path / "a.mcap", [*exchange(0), *exchange(400)])
    other = _log(tmp_path / "b.mcap", exchange(200))
    with pytest.raises(UsageError, match="at the same time"):
        _convert([one, other], tmp_path / "x.mcap")
    assert not (tmp_path / "x.mcap").exists()


@pytest.mark.parametrize("suffix", [".pcapng", ".mcap"])
def test_a_cut_has_what_decode_shows_of_the_part(suffix: str, tmp_path: Path) -> None:
    path, out = CAPTURES / "ft1a-touch-line.mcap", tmp_path / f"x{suffix}"
    _convert([path], out, start="0.1", end="0.3")
    first = _transactions(path)[0].request_ns  # type: ignore[union-attr]
    expected = [
        one.request_raw  # type: ignore[union-attr]
        for one in _transactions(path)
        if 100_000_000 <= one.request_ns - first < 300_000_000  # type: ignore[union-attr, operator]
    ]
    assert [one.request_raw for one in _transactions(out)] == expected  # type: ignore[union-attr]
    assert len(expected) == 4


@pytest.mark.parametrize(
    ("name", "suffix"), [("ft1a-touch-line.mcap", ".pcapng"), ("fa3-at1m8x-setup.pcap", ".pcap")]
)
def test_where_keeps_the_packets_of_its_transactions(
    name: str, suffix: str, tmp_path: Path
) -> None:
    out = tmp_path / f"x{suffix}"
    _convert([CAPTURES / name], out, where="function == 6")
    expected = [one for one in _transactions(CAPTURES / name) if one.function == 6]  # type: ignore[union-attr]
    assert expected
    assert [
        (one.request_raw, one.response_raw)  # type: ignore[union-attr]
        for one in _transactions(out)
    ] == [(one.request_raw, one.response_raw) for one in expected]  # type: ignore[union-attr]


@pytest.mark.parametrize("suffix", [".pcapng", ".mcap"])
@pytest.mark.parametrize(("unit", "damaged"), [(sick.WELL, 0), (sick.BAD_CRC, 4)])
def test_where_takes_no_fault_of_others_along_but_the_damaged_answers_of_its_own(
    unit: int, damaged: int, suffix: str, tmp_path: Path
) -> None:
    log, out = sick.sick_line(tmp_path / "sick.mcap", 24), tmp_path / f"x{suffix}"
    _convert([log], out, where=f"unit == {unit}")
    for raw in (False, True):
        records = list(Reading([str(out)], ReadingOptions(raw=raw)).records())
        events = [one for one in records if isinstance(one, WireEvent)]
        assert [one.kind for one in events] == [EventKind.BAD_CHECK] * damaged
        found = DamagedAnswers()
        for one in events:
            found.note(one)
        assert sum(found.has(one) for one in records if not isinstance(one, WireEvent)) == damaged
        assert len(records) == 24 + damaged


@pytest.mark.parametrize("is_anonymous", [False, True])
@pytest.mark.parametrize("between", [(), (".pcapng",), (".mcap",), (".mcap", ".pcapng", ".mcap")])
def test_a_framing_error_of_a_line_stays(
    between: tuple[str, ...], tmp_path: Path, *, is_anonymous: bool
) -> None:
    path = CAPTURES / "findings" / "RTU-203.pcap"
    for number, suffix in enumerate(between):
        out = tmp_path / f"{number}{suffix}"
        window = TimeWindow.parse(None, None)
        conversion = Conversion([str(path)], ReadingOptions(), window)
        if is_anonymous:
            with anonymous_conversion(conversion, b"key", AnonymousChoice()) as copy:
                copy.write(str(out))
        else:
            conversion.write(str(out))
        path = out
    records = list(Reading([str(path)], ReadingOptions()).records())
    errors = [one for one in records if isinstance(one, WireEvent)]
    assert [(one.kind, one.message) for one in errors] == [
        (EventKind.LINE_ERROR, "a framing error")
    ]
    (first, _) = (one for one in records if isinstance(one, NamedTransaction))
    assert first.response_ns is not None
    assert errors[0].link == first.link
    assert errors[0].ts_ns - first.response_ns == 50_000_000


def test_a_part_chosen_by_transactions_has_no_errors_of_the_line(tmp_path: Path) -> None:
    out = tmp_path / "x.pcapng"
    _convert([CAPTURES / "findings" / "RTU-203.pcap"], out, where="unit == 1")
    assert not any(
        isinstance(one, WireEvent) for one in Reading([str(out)], ReadingOptions()).records()
    )


def test_a_serial_line_does_not_fit_into_pcap(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match=r"name it .*x\.pcapng"):
        _convert([CAPTURES / "ft1a-touch-line.mcap"], tmp_path / "x.pcap")
    assert not (tmp_path / "x.pcap").exists()


@pytest.mark.parametrize("name", ["plant.pcap", "fa3-at1m8x-setup.pcap"])
def test_transactions_of_a_network_become_packets_that_give_them_again(
    name: str, tmp_path: Path
) -> None:
    lines, packets = tmp_path / "x.jsonl", tmp_path / "x.pcap"
    before = [one for one in _transactions(CAPTURES / name) if isinstance(one, NamedTransaction)]
    lines.write_bytes(b"".join(transaction_to_jsonl(one) for one in before))
    done = _convert([lines], packets)
    after = [one for one in _transactions(packets) if isinstance(one, NamedTransaction)]
    assert done.packets == sum((one.request_raw is not None) + (one.response_raw is not None)
                               for one in before)  # fmt: skip
    unseen = dict.fromkeys(("source_mac", "destination_mac", "response_mac"))
    seen = [msgspec.structs.replace(one, **unseen) for one in before]
    assert sorted(after, key=attrgetter("start_ns")) == sorted(seen, key=attrgetter("start_ns"))


def test_a_tap_goes_into_pcap_unless_an_end_has_only_a_name(tmp_path: Path) -> None:
    (one, *_) = _transactions(CAPTURES / "plant.pcap")
    assert isinstance(one, NamedTransaction)
    lines = tmp_path / "x.jsonl"
    lines.write_bytes(
        transaction_to_jsonl(msgspec.structs.replace(one, destination="plc.example:502"))
    )
    with pytest.raises(UsageError, match=r"'plc\.example' .*; name it .*x\.pcapng"):
        _convert([lines], tmp_path / "x.pcap")
    assert not (tmp_path / "x.pcap").exists()


def test_a_table_of_transactions_is_not_converted_back(tmp_path: Path) -> None:
    (tmp_path / "x.parquet").write_bytes(b"PAR1")
    with pytest.raises(InputError, match="is not converted back"):
        _convert([tmp_path / "x.parquet"], tmp_path / "x.mcap")


def test_a_tap_comes_back_with_its_connections(tmp_path: Path) -> None:
    chunks = [
        relayed(100 * number + late, side, pdu, number=number)
        for number in range(3)
        for late, side, pdu in ((0, Direction.REQUEST, READ), (10, Direction.RESPONSE, VALUES))
    ]
    path = _log(tmp_path / "tap.mcap", chunks)
    _convert([path], tmp_path / "x.pcapng")
    assert len(_transactions(path)) == 3
    assert _transactions(tmp_path / "x.pcapng") == _transactions(path)


def test_two_frames_in_one_read_stay_in_one_read(tmp_path: Path) -> None:
    request, response = rtu_adu(1, b"\x03\x00\x00\x00\x01"), rtu_adu(1, b"\x03\x02\x12\x34")
    chunk = Chunk(ts_ns=10**18, link=LINE.name, data=request + response)
    path = _log(tmp_path / "glued.mcap", [chunk])
    assert _convert([path], tmp_path / "x.pcapng") == Converted(packets=2)
    _convert([tmp_path / "x.pcapng"], tmp_path / "back.mcap")
    assert _evidence(tmp_path / "back.mcap") == [chunk]


def test_the_parts_of_a_rotated_log_join_in_any_order(tmp_path: Path) -> None:
    chunks = [chunk for number in range(3) for chunk in exchange(200 * number)]
    whole = _log(tmp_path / "whole.mcap", chunks)
    folder = tmp_path / "parts"
    folder.mkdir()
    with RotatingLog(folder / "log.mcap", Rotation(time_ns=1), capture={}) as log:
        log.add_link(LINE.name, {SPEC: str(LINE)})
        for number, chunk in enumerate(chunks):
            log.tick(number)
            log.write(chunk)
    parts = sorted(folder.iterdir())
    assert len(parts) == len(chunks)
    _convert(reversed(parts), tmp_path / "x.pcapng")
    _convert(parts[1:] + parts[:1], tmp_path / "x.mcap")
    expected = _transactions(whole)
    assert [one.outcome for one in expected] == ["ok"] * 3  # type: ignore[union-attr]
    assert _transactions(tmp_path / "x.pcapng") == _transactions(tmp_path / "x.mcap") == expected
