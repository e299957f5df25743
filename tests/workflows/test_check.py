from __future__ import annotations

import gzip
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from mbtool.core import InputError, UsageError
from mbtool.devices import Assignments, load_profile, parse_assignment, profile_to_json
from mbtool.logs import LogWriter
from mbtool.workflows.check import CheckRun, CodeFilter
from mbtool.workflows.shared.reading import ReadingOptions
from mbtool.workflows.shared.time_window import TimeWindow
from tests.golden.findings_captures import Bus, Net

if TYPE_CHECKING:
    from collections.abc import Sequence

FOLDER = Path(__file__).resolve().parents[2] / "captures"
FINDINGS = FOLDER / "findings"

BROKEN = "05 0000 0001"


def checked(*paths: Path, devices: Sequence[str] = (), codes: CodeFilter | None = None) -> CheckRun:
    options = ReadingOptions(assignments=Assignments(map(parse_assignment, devices)))
    return CheckRun([str(path) for path in paths], options, codes)


def codes(*paths: Path, devices: Sequence[str] = (), codes: CodeFilter | None = None) -> list[str]:
    run = checked(*paths, devices=devices, codes=codes)
    return [placed.finding.code for placed in run.findings()]


def test_a_capture_is_held_against_the_rules_of_all() -> None:
    assert codes(FINDINGS / "MB-103.pcap") == ["MB-103"]
    assert codes(FINDINGS / "FT1A-Q16.pcap") == []


def test_a_device_that_the_user_names_has_its_rules() -> None:
    assert codes(FINDINGS / "FT1A-Q16.pcap", devices=["1=idec-ft1a-touch"]) == ["FT1A-Q16"]


def test_a_log_names_its_devices_and_its_lines() -> None:
    assert codes(FOLDER / "ft1a-touch-line.mcap") == ["FT1A-F15", "FT1A-A3"]
    log = FOLDER / "torn-and-glued-frames.mcap"
    assert "RTU-104" in codes(log)
    assert "MB-401" in codes(log)


def test_the_users_profiles_replace_those_of_the_log() -> None:
    log = FOLDER / "ft1a-touch-line.mcap"
    found = codes(log, devices=["1=idec-ft1a-smartaxis"])
    assert not [code for code in found if code.startswith("FT1A")]


# The capture has three polls a second, a write in second 5, and a repeated request in second 7.
def in_part(path: Path, start: str | None = None, end: str | None = None) -> CheckRun:
    return CheckRun([str(path)], ReadingOptions(), window=TimeWindow.parse(start, end))


@pytest.mark.parametrize(
    ("start", "end", "transactions", "found"),
    [
        (None, None, 63, ["MB-401"]),
        ("7", None, 41, ["MB-401"]),
        ("8.5", None, 35, []),
        (None, "7", 22, []),
        ("2026-01-01T00:00:07", "2026-01-01T00:00:08.100", 6, ["MB-402"]),
        ("2026-01-01T00:00:08.100", None, 35, []),
        ("1h", None, 0, []),
    ],
)
def test_only_a_part_of_a_capture_is_checked(
    start: str | None, end: str | None, transactions: int, found: list[str]
) -> None:
    run = in_part(FOLDER / "plant.pcap", start, end)
    assert [one.finding.code for one in run.findings()] == found
    assert run.transactions == transactions


def test_a_connection_that_was_opened_before_the_part_is_known() -> None:
    """The third connection to a module that has two is at 0.011 s."""
    devices = Assignments([parse_assignment("10.0.0.2=fa3-at1m8x")])
    options = ReadingOptions(assignments=devices)
    for start, found in (("2026-01-01T00:00:00.010", ["FA3-X2"]), ("2026-01-01T00:00:00.012", [])):
        window = TimeWindow.parse(start, None)
        run = CheckRun([str(FINDINGS / "FA3-X2.pcap")], options, window=window)
        assert [one.finding.code for one in run.findings()] == found


def test_a_part_of_standard_input_needs_dates() -> None:
    run = CheckRun(["-"], ReadingOptions(), window=TimeWindow.parse("5", None))
    with pytest.raises(UsageError, match="give dates"):
        list(run.findings())


def test_findings_are_counted_and_placed() -> None:
    run = checked(FINDINGS / "MB-401.pcap", FINDINGS / "MB-103.pcap")
    placed = [(one.finding.code, Path(one.file).name) for one in run.findings()]
    assert placed == [("MB-401", "MB-401.pcap"), ("MB-103", "MB-103.pcap")]
    assert run.counts == {"MB-401": 1, "MB-103": 1}
    assert run.transactions == 6


def test_each_capture_is_checked_on_its_own(tmp_path: Path) -> None:
    """A request that one leaves open is not answered in another of an earlier time."""
    net = Net()
    talk = net.open()
    net.ask(talk, "03 0000 0001")
    (tmp_path / "open.pcap").write_bytes(net.file())
    earlier = Net(now_ns=net.now_ns - 10**12)
    earlier.asked(earlier.open())
    (tmp_path / "other.pcap").write_bytes(earlier.file())
    assert codes(tmp_path / "open.pcap", tmp_path / "other.pcap") == []


def test_the_parts_of_one_capture_are_one(tmp_path: Path) -> None:
    net = Net()
    talk = net.open()
    net.ask(talk, "03 0000 0001")
    first = net.file()
    net.packets.clear()
    net.wait(1500).answer(talk, "03 02 1234").wait(2000).asked(talk)
    (tmp_path / "a.pcap").write_bytes(first)
    (tmp_path / "b.pcap").write_bytes(net.file())
    assert codes(tmp_path / "a.pcap", tmp_path / "b.pcap") == []


def test_a_cut_capture_is_checked_up_to_the_cut(tmp_path: Path) -> None:
    net = Net()
    talk = net.open()
    data = net.asked(talk, BROKEN, "85 03").asked(talk).file()
    (tmp_path / "cut.pcap").write_bytes(data[:-5])
    run = checked(tmp_path / "cut.pcap")
    with pytest.raises(InputError, match="middle of a record"):
        list(run.findings())
    assert run.counts == {"MB-103": 1}


def test_a_packed_capture_is_read(tmp_path: Path) -> None:
    (tmp_path / "x.pcap.gz").write_bytes(gzip.compress((FINDINGS / "MB-103.pcap").read_bytes()))
    assert codes(tmp_path / "x.pcap.gz") == ["MB-103"]


def test_bytes_without_times_give_no_findings_about_times(tmp_path: Path) -> None:
    bus = Bus()
    for number in range(48):
        bus.frame(1, "03 0000 0001", after_ms=200 if number % 8 else 400)
        bus.frame(1, "03 02 1234")
    (tmp_path / "line.pcap").write_bytes(bus.file())
    (tmp_path / "line.bin").write_bytes(b"".join(packet.data for packet in bus.packets))
    assert codes(tmp_path / "line.pcap") == ["MB-404"]
    from mbtool.core import parse_line

    options = ReadingOptions(line=parse_line("rtu"))
    assert not [*CheckRun([str(tmp_path / "line.bin")], options).findings()]


@pytest.mark.parametrize(
    ("select", "ignore", "taken"),
    [
        ([], [], ["FT1A-Q16", "MB-101", "MB-401", "RTU-101"]),
        (["MB"], [], ["MB-101", "MB-401"]),
        (["mb-1, rtu"], [], ["MB-101", "RTU-101"]),
        ([], ["MB"], ["FT1A-Q16", "RTU-101"]),
        (["MB"], ["MB-4"], ["MB-101"]),
        (["MB-401"], ["MB"], ["MB-401"]),
        (["MB"], ["MB"], []),
        (["FT1A-Q"], [], ["FT1A-Q16"]),
    ],
)
def test_codes_are_selected_by_their_beginning(
    select: list[str], ignore: list[str], taken: list[str]
) -> None:
    codes = CodeFilter.parse(select, ignore)
    every = ["FT1A-Q16", "MB-101", "MB-401", "RTU-101"]
    assert [code for code in every if codes.takes(code)] == taken


def test_findings_that_are_not_chosen_are_not_counted() -> None:
    run = checked(FINDINGS / "MB-103.pcap", codes=CodeFilter.parse([], ["MB"]))
    assert not [*run.findings()]
    assert not run.counts


@pytest.mark.parametrize(
    "known", ["RTU", "rtu-1", "MB-401", "F", "FA3-X", "FA3", "FT1A-Q16", "WAGO-"]
)
def test_a_beginning_that_some_code_has_is_taken(known: str) -> None:
    checked(FINDINGS / "MB-103.pcap", codes=CodeFilter.parse([known], [])).demand_codes()


@pytest.mark.parametrize("unknown", ["RUT", "RTU-9", "FT1A-Z", "Q16", "FT1A-1"])
def test_a_beginning_that_no_code_has_is_refused(unknown: str) -> None:
    run = checked(FINDINGS / "MB-103.pcap", codes=CodeFilter.parse([], [unknown]))
    with pytest.raises(UsageError, match=f"no code begins with '{unknown}'"):
        run.demand_codes()


OWN_DEVICE = """
extends = "idec-ft1a-touch"
name = "line-7"
title = "Operator interface of line 7"
finding_prefix = "LINE7"
"""


def test_codes_of_the_users_own_device_are_known(tmp_path: Path) -> None:
    (tmp_path / "own.toml").write_text(OWN_DEVICE)
    codes = CodeFilter.parse(["LINE7-Q"], [])
    with pytest.raises(UsageError):
        checked(FINDINGS / "FT1A-Q16.pcap", codes=codes).demand_codes()
    run = checked(
        FINDINGS / "FT1A-Q16.pcap",
        devices=[f"1={tmp_path / 'own.toml'}"],
        codes=codes,
    )
    run.demand_codes()
    assert [one.finding.code for one in run.findings()] == ["LINE7-Q16"]


def test_codes_of_a_device_that_a_log_carries_are_known(tmp_path: Path) -> None:
    (tmp_path / "own.toml").write_text(OWN_DEVICE)
    profile = load_profile(str(tmp_path / "own.toml"))
    with LogWriter(tmp_path / "x.mcap", capture={}) as log:
        log.add_profile(profile.name, profile_to_json(profile))
        log.add_device("1", profile.name)
    checked(tmp_path / "x.mcap", codes=CodeFilter.parse(["LINE7"], [])).demand_codes()
    with pytest.raises(UsageError, match=r"no code begins with 'LINE8'; they begin with .*LINE7"):
        checked(tmp_path / "x.mcap", codes=CodeFilter.parse(["LINE8"], [])).demand_codes()


def test_silences_that_are_too_few_for_a_finding_are_a_remark() -> None:
    run = checked(FINDINGS / "RTU-101-nearly.pcap")
    assert not [*run.findings()]
    remark = run.remarks[-1]
    assert ": a silence longer than t1.5 inside a frame in 1 of 16 transactions; so few" in remark


def test_a_slave_that_says_its_model_is_a_remark() -> None:
    run = checked(FOLDER / "fa3-at1m8x-setup.pcap")
    assert not [*run.findings()]
    (remark,) = run.remarks
    assert remark.endswith("name it with --device 127.0.0.1/0=fa3-at1m8x")
