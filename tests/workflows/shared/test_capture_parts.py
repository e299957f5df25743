"""Files that are parts of one capture, and files that are not."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import pytest

from mbtool.core import CutError, Direction, Packet, WireEvent
from mbtool.decode.decoder import Decoder
from mbtool.devices import Namer
from mbtool.logs import LogWriter, RotatingLog, Rotation
from mbtool.logs.links import SPEC
from mbtool.workflows.shared.capture_parts import BACK_NS, GAP_NS, Part, Seam
from mbtool.workflows.shared.reading import Reading, ReadingOptions
from tests.packets.building import pcap
from tests.records import without_origins
from tests.workflows.evidence import LINE, READ, VALUES, captured, exchange, relayed

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence
    from pathlib import Path

    from mbtool.core import Chunk
    from mbtool.decode.decoder import Record

RTAC_SERIAL = 250


def _read(paths: Iterable[Path], *, raw: bool = False) -> list[Record]:
    reading = Reading([str(path) for path in paths], ReadingOptions(raw=raw))
    return without_origins(reading.records())


def _outcomes(records: Iterable[Record]) -> list[str]:
    return [record.outcome for record in records if not isinstance(record, WireEvent)]


def _written(folder: Path, *parts: Sequence[Packet]) -> list[Path]:
    paths = [folder / f"part-{number}.pcap" for number in range(len(parts))]
    for path, packets in zip(paths, parts, strict=True):
        path.write_bytes(pcap(list(packets)))
    return paths


def _serial_packets(count: int) -> list[Packet]:
    """Exchanges on a serial line, as an RTAC records it: behind a header of 12 bytes."""
    return [
        Packet(
            ts_ns=chunk.ts_ns,
            link="if0",
            link_type=RTAC_SERIAL,
            data=bytes(12) + chunk.data,
            original_length=12 + len(chunk.data),
        )
        for number in range(count)
        for chunk in exchange(100 * number)
    ]


@pytest.mark.parametrize("cut", range(1, 12))
def test_a_connection_goes_on_in_the_next_capture_wherever_it_is_cut(
    tmp_path: Path, cut: int
) -> None:
    packets = captured(3)
    paths = _written(tmp_path, packets, packets[:cut], [], packets[cut:])
    assert _read(paths[1:]) == _read(paths[:1])


@pytest.mark.parametrize("cut", range(1, 6))
def test_a_serial_line_goes_on_in_the_next_capture(tmp_path: Path, cut: int) -> None:
    packets = _serial_packets(3)
    parts = [packets, packets[:cut], packets[cut:]]
    paths = _written(tmp_path, *parts)
    whole = _read(paths[:1])
    assert _outcomes(whole) == ["ok"] * 3
    assert _read(paths[1:]) == whole


def test_a_capture_that_begins_earlier_is_another(tmp_path: Path) -> None:
    packets = captured(3)
    hour_ns = 3600 * 1_000_000_000
    begin, end = (
        [replace(one, ts_ns=one.ts_ns + at_ns) for one in some]
        for some, at_ns in ((packets[:4], hour_ns), (packets[4:], hour_ns))
    )
    long_ago = [replace(one, ts_ns=one.ts_ns - hour_ns) for one in end]
    first, second, other = _written(tmp_path, begin, end, long_ago)
    assert _outcomes(_read([first, second])) == ["ok"] * 3
    # The cut divides an exchange.
    for paths in ([second, other, first], [first, other]):
        outcomes = [*_outcomes(_read(paths))]
        assert outcomes.count("not-captured") >= 2


def _cut(path: Path) -> Path:
    path.write_bytes(path.read_bytes()[:-1])
    return path


def _read_to_the_cut(paths: Iterable[Path], *, raw: bool = False) -> tuple[Reading, list[Record]]:
    """What is read of files of which some are cut: the first is named after all else."""
    reading = Reading([str(path) for path in paths], ReadingOptions(raw=raw))
    records: list[Record] = []
    with pytest.raises(CutError) as raised:
        records.extend(reading.records())
    assert str(raised.value).startswith(str(next(one for one in paths if "cut" in one.name)))
    return reading, records


def test_parts_behind_one_that_is_cut_are_read_behind_a_gap(tmp_path: Path) -> None:
    packets = captured(6)
    parts = _written(tmp_path, packets[:5], packets[5:8], packets[8:11], packets[11:])
    parts[1], parts[2] = (_cut(one.rename(tmp_path / f"cut-{one.name}")) for one in parts[1:3])
    reading, records = _read_to_the_cut(parts)
    outcomes = _outcomes(records)
    assert outcomes.count("ok") == 4
    gaps = [one for one in records if isinstance(one, WireEvent) and one.kind == "gap"]
    # Two files, and the bytes that their last packets had.
    assert [bool(one.link) for one in gaps].count(False) == 2
    assert "cut-part-1.pcap" in gaps[0].message
    assert [one for one in reading.remarks if "cut-part-2.pcap" in one]
    assert isinstance(records[-1], WireEvent)
    assert records[-1].kind == "closed"


def test_a_serial_line_does_not_go_on_behind_a_cut(tmp_path: Path) -> None:
    packets = _serial_packets(3)
    parts = _written(tmp_path, packets[:4], packets[4:])
    parts[0] = _cut(parts[0].rename(tmp_path / "cut.pcap"))
    _, records = _read_to_the_cut(parts)
    assert _outcomes(records) == ["ok", "not-captured", "ok"]


@pytest.mark.parametrize("raw", [False, True])
def test_parts_of_a_log_behind_one_that_is_cut_are_read_behind_a_gap(
    tmp_path: Path, raw: bool
) -> None:
    evidence = [chunk for at_ms in range(0, 900, 100) for chunk in exchange(at_ms)]
    parts = [tmp_path / "cut.mcap", tmp_path / "next.mcap"]
    for number, path in enumerate(parts):
        decoder = Decoder(Namer(), lines={LINE.name: LINE})
        with LogWriter(path, capture={"part": str(number + 1)}) as log:
            _introduce(log)
            for place, chunk in enumerate(evidence[12 * number :][:12]):
                log.write(chunk)
                for record in decoder.feed(chunk):
                    log.write(record)
                log.tick(place * 1_000_000_000)
            for record in decoder.close():
                log.write(record)
    data = parts[0].read_bytes()
    parts[0].write_bytes(data[: len(data) // 3])
    _, records = _read_to_the_cut(parts, raw=raw)
    (gap,) = [one for one in records if isinstance(one, WireEvent) and one.kind == "gap"]
    at = records.index(gap)
    assert gap.ts_ns >= evidence[0].ts_ns
    assert "ok" in _outcomes(records[:at])
    assert _outcomes(records[at:]) == ["ok"] * 3


def test_a_part_that_is_named_too_late_is_told_once(tmp_path: Path) -> None:
    packets = [
        replace(one, ts_ns=one.ts_ns + 2 * BACK_NS * place) for place, one in enumerate(captured(6))
    ]
    paths = _written(tmp_path, packets[:3], packets[3:6], packets[6:9], packets[9:12], packets[12:])
    reading = Reading([str(paths[at]) for at in (0, 1, 4, 2, 3)], ReadingOptions())
    list(reading.records())
    order = f"{paths[2]}: begins before {paths[4]} ends"
    assert [one.startswith(order) for one in reading.remarks].count(True) == 1
    in_order = Reading([str(path) for path in paths], ReadingOptions())
    list(in_order.records())
    assert not any("begins before" in one for one in in_order.remarks)


def test_a_capture_of_another_link_type_is_another() -> None:
    one = captured(1)[0]
    seam = Seam()
    assert seam.is_continued_by(one)
    seam.note(one)
    assert seam.is_continued_by(one)
    assert seam.is_continued_by(replace(one, ts_ns=one.ts_ns - BACK_NS))
    assert not seam.is_continued_by(replace(one, ts_ns=one.ts_ns - BACK_NS - 1))
    assert not seam.is_continued_by(replace(one, link_type=113))


def test_a_capture_that_begins_much_later_is_another() -> None:
    one = captured(1)[0]
    seam = Seam()
    seam.note(one)
    assert seam.is_continued_by(replace(one, ts_ns=one.ts_ns + GAP_NS))
    assert not seam.is_continued_by(replace(one, ts_ns=one.ts_ns + GAP_NS + 1))
    seam.note(replace(one, ts_ns=one.ts_ns + 10 * GAP_NS))
    assert seam.is_continued_by(replace(one, ts_ns=one.ts_ns + 20 * GAP_NS))


def test_a_capture_that_begins_no_later_than_the_one_before_it_is_another() -> None:
    one = captured(1)[0]
    seam = Seam()
    seam.note(one)
    seam.note(replace(one, ts_ns=one.ts_ns + 1))
    assert not seam.is_continued_by(one)
    assert seam.is_continued_by(replace(one, ts_ns=one.ts_ns + 1))


def _talk() -> list[Chunk]:
    """On a serial line and on a connection through a tap, at the same time."""
    return [
        chunk
        for number in range(4)
        for chunk in (
            *exchange(200 * number),
            relayed(200 * number + 30, Direction.REQUEST, READ, number=number),
            relayed(200 * number + 40, Direction.RESPONSE, VALUES, number=number),
        )
    ]


def _introduce(log: LogWriter | RotatingLog) -> None:
    log.add_link(LINE.name, {SPEC: str(LINE)})


def _rotated(folder: Path, chunks: Sequence[Chunk | Packet], every: int = 1) -> list[Path]:
    """A log of these that goes on in a next file after every so many."""
    folder.mkdir(exist_ok=True)
    rotation = Rotation(size=None, time_ns=every)
    with RotatingLog(folder / "log.mcap", rotation, capture={"host": "bench"}) as log:
        _introduce(log)
        for number, chunk in enumerate(chunks):
            log.tick(number)
            log.write(chunk)
    return sorted(folder.glob("*.mcap"), key=lambda path: (len(path.stem), path.stem))


def _whole(folder: Path, chunks: Sequence[Chunk | Packet]) -> Path:
    path = folder / "whole.mcap"
    with LogWriter(path, capture={"host": "bench"}) as log:
        _introduce(log)
        for chunk in chunks:
            log.write(chunk)
    return path


@pytest.mark.parametrize("every", [1, 3, 5])
@pytest.mark.parametrize("evidence", [_talk(), captured(3)], ids=["chunks", "packets"])
def test_a_rotated_log_decodes_to_the_same_as_the_whole(
    tmp_path: Path, evidence: Sequence[Chunk | Packet], every: int
) -> None:
    parts = _rotated(tmp_path / "parts", evidence, every)
    assert len(parts) >= len(evidence) // every
    whole = _read([_whole(tmp_path, evidence)], raw=True)
    assert set(_outcomes(whole)) == {"ok"}
    assert _read(parts, raw=True) == whole


def test_a_part_that_is_missing_or_misplaced_joins_nothing(tmp_path: Path) -> None:
    first, second, *_ = _rotated(tmp_path / "parts", exchange(0))
    assert _outcomes(_read([first, second], raw=True)) == ["ok"]
    assert _outcomes(_read([second, first], raw=True)) == ["not-captured"] * 2
    request, *_, response = parts = _rotated(
        tmp_path / "three", [exchange(0)[0], *exchange(5)[:1], exchange(0)[1]]
    )
    assert len(parts) == 3
    assert _outcomes(_read([request, response], raw=True)) == ["not-captured"] * 2


def test_two_recordings_are_not_parts_of_one(tmp_path: Path) -> None:
    request, response = exchange(0)
    paths = []
    for name, chunk in (("a", request), ("b", response)):
        (tmp_path / name).mkdir()
        paths.append(_whole(tmp_path / name, [chunk]))
    assert _outcomes(_read(paths, raw=True)) == ["not-captured"] * 2


def test_a_log_and_a_capture_are_not_parts_of_one(tmp_path: Path) -> None:
    packets = captured(1)
    log = _whole(tmp_path, packets[:4])
    (capture,) = _written(tmp_path, packets[4:])
    joined = _read([log, capture], raw=True)
    assert _outcomes(joined) == ["not-captured"] * 2


def test_part_numbers_follow_each_other() -> None:
    run = ({"host": "bench"},)
    assert Part(2, run).follows(Part(1, run))
    assert not Part(3, run).follows(Part(1, run))
    assert not Part(1, run).follows(Part(0, run))  # Not rotated, so there is no next.
    assert not Part(2, run).follows(Part(1, ({"host": "other"},)))
    assert not Part(2, run).follows(Part())
    assert not Part().follows(Part(1, run))
    assert not Part().follows(None)
    assert Part().follows(Part())
