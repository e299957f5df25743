"""What check finds in a capture does not depend on how the capture is read."""

from __future__ import annotations

from pathlib import Path
from random import Random
from typing import TYPE_CHECKING
from unittest.mock import patch

import pytest

from mbtool.columns import packet_block, quiet_rows
from mbtool.core import Direction, InputError
from mbtool.devices.checking import checker, polls, unpolled
from mbtool.devices.checking.checker import Checker
from mbtool.ledger import account
from mbtool.modbus import encode_pdu
from mbtool.workflows.check import CheckRun, FileFinding
from mbtool.workflows.shared import reading_choice
from mbtool.workflows.shared.column_reading import ColumnReading
from mbtool.workflows.shared.reading import Reading, ReadingOptions
from tests.benchmarks.file_workloads import (
    clean,
    dirty,
    make_capture,
    per_poll,
    random_requests,
    scan,
)
from tests.captures import public_folder
from tests.columns.both_ways import generated
from tests.columns.sunspec_capture import sunspec_capture
from tests.columns.test_equality import READ, poll
from tests.packets.building import Talk, pcap

if TYPE_CHECKING:
    import random
    from collections.abc import Callable, Iterator

    from mbtool.core import Packet

Found = tuple["list[FileFinding]", list[str], tuple[int, dict[str, int]], str | None, type]
"""Findings, remarks, numbers of transactions and of failed requests, the error, the reader."""
MOST_BYTES = 300_000
NEVER = 1 << 60


def found_of_few(path: Path) -> Found:
    """The same as `found` by arrays, with small blocks, and quiet rows together from two on."""
    with (
        patch.object(packet_block, "BLOCK_PACKETS", 150),
        patch.object(quiet_rows, "FEWEST", 2),
        patch.object(checker, "_ONE_BY_ONE", 1),
    ):
        return found(path, 0)


def found(path: Path, at_least: int) -> Found:
    """The findings of a capture; it is read as arrays if it has at least so many bytes."""
    with patch.object(reading_choice, "WORTH_BYTES", at_least):
        run = CheckRun([str(path)], ReadingOptions())
    findings: list[FileFinding] = []
    error = None
    try:
        findings.extend(run.findings())
    except InputError as broken:
        error = str(broken)
    counts = run.transactions, run.failed_requests()
    return findings, run.remarks, counts, error, type(run.reading)


def demand_equal(path: Path) -> bool:
    """Compare both ways; True if the capture can be read as arrays."""
    *one_by_one, row_way = found(path, NEVER)
    *as_arrays, array_way = found(path, 0)
    assert as_arrays == one_by_one
    assert [*found_of_few(path)][:4] == one_by_one
    assert row_way is Reading
    return array_way is ColumnReading


@pytest.mark.public_captures
def test_the_findings_of_public_captures_are_the_same_both_ways() -> None:
    paths = [
        path
        for path in sorted(public_folder().rglob("*.pcap*"))
        if path.name.endswith(("pcap", "pcapng", "gz")) and path.stat().st_size < MOST_BYTES
    ]
    if not paths:
        pytest.skip("no captures made by others")
    assert sum(map(demand_equal, paths)) > 20


@pytest.mark.parametrize("number", range(0, 60, 4))
def test_the_findings_of_simulated_plants_are_the_same_both_ways(
    number: int, tmp_path: Path
) -> None:
    path = tmp_path / "plant.pcap"
    path.write_bytes(generated(number, requests=100))
    assert demand_equal(path)


@pytest.mark.parametrize(
    "frames", [random_requests, scan, per_poll, dirty], ids=lambda one: one.__name__
)
def test_the_findings_of_many_different_requests_are_the_same_both_ways(
    frames: Callable[[int, random.Random], Iterator[tuple[bytes, int]]], tmp_path: Path
) -> None:
    made = make_capture(tmp_path / "many.pcap", frames, 3000)
    assert demand_equal(made.path)


@pytest.mark.parametrize("frames", [random_requests, scan], ids=lambda one: one.__name__)
def test_what_was_forgotten_of_many_different_requests_is_the_same_both_ways(
    frames: Callable[[int, random.Random], Iterator[tuple[bytes, int]]], tmp_path: Path
) -> None:
    made = make_capture(tmp_path / "many.pcap", frames, 2000)
    with (
        patch.object(polls, "MAX_POLLS", 40),
        patch.object(polls, "MIN_PERIODS", 2),
        patch.object(account, "MAX_POLLS", 40),
        patch.object(unpolled, "MAX_TARGETS", 40),
    ):
        assert demand_equal(made.path)


@pytest.mark.parametrize("masters", [1, 2, 3])
@pytest.mark.parametrize("apart_ns", [1_000_000, 70_000_000_000])
def test_the_findings_of_writes_by_several_masters_are_the_same_both_ways(
    masters: int, apart_ns: int, tmp_path: Path
) -> None:
    rng = Random(masters)
    packets: list[Packet] = []
    talks = [Talk(ts_ns=number * apart_ns) for number in range(masters)]
    for number, talk in enumerate(talks):
        talk.master.host = f"10.0.0.{20 + number}"
        packets += [*talk.handshake(), *poll(talk, 30)]
    for _ in range(60):
        talk = rng.choice(talks)
        talk.ts_ns = packets[-1].ts_ns + rng.choice((1, apart_ns))
        write = encode_pdu(0x06, Direction.REQUEST, address=rng.randrange(3), value=7)
        packets += poll(talk, rng.choice((1, 4, 30)), write, write)
        packets += poll(talk, rng.choice((0, 1, 30)))
    path = tmp_path / "writes.pcap"
    path.write_bytes(pcap(packets, magic=0xA1B23C4D))
    assert demand_equal(path)
    codes = {one.finding.code for one in found(path, 0)[0]}
    assert ("SEC-101" in codes) is (masters > 1)


@pytest.mark.parametrize("frames", [clean, dirty], ids=lambda one: one.__name__)
def test_the_findings_of_steady_polling_are_the_same_both_ways(
    frames: Callable[[int, random.Random], Iterator[tuple[bytes, int]]], tmp_path: Path
) -> None:
    made = make_capture(tmp_path / "polls.pcap", frames, 3000)
    with patch.object(Checker, "feed_rows", autospec=True, side_effect=Checker.feed_rows) as taken:
        assert demand_equal(made.path)
    assert sum(len(rows) for (_, rows), _ in taken.call_args_list) > 600


@pytest.mark.parametrize("before", [0, 1, 20])
def test_a_sunspec_device_is_told_both_ways(tmp_path: Path, before: int) -> None:
    path = tmp_path / "meter.pcap"
    path.write_bytes(sunspec_capture(before))
    assert demand_equal(path)
    assert "SunSpec models 1, 64900" in found(path, 0)[1][0]


def test_the_findings_of_a_cut_capture_are_the_same_both_ways(tmp_path: Path) -> None:
    path = tmp_path / "plant.pcap"
    path.write_bytes(generated(0)[:-20])
    assert demand_equal(path)
    assert found(path, 0)[3] is not None


def test_a_case_of_a_trouble_names_the_file_that_has_it(tmp_path: Path) -> None:
    names = [str(tmp_path / name) for name in ("a.pcap", "b.pcap")]
    day_ns = 86_400_000_000_000
    for day, (name, refused) in enumerate(zip(names, (1, 400), strict=True)):
        talk = Talk(ts_ns=day * day_ns)
        packets = [*talk.handshake(), *poll(talk, 60), *poll(talk, refused, READ, b"\x83\x02")]
        Path(name).write_bytes(pcap([*packets, *poll(talk, 60)]))
    with patch.object(reading_choice, "WORTH_BYTES", 0):
        run = CheckRun(names, ReadingOptions())
        assert list(run.findings()) == []
    told = [one for trouble in run.judgement().troubles for one in trouble.evidence]
    assert {names.index(one.file or "") for one in told} == {0, 1}
    assert all(names.index(one.file or "") == one.ts_ns // day_ns for one in told)
