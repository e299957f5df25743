"""mbtool scan of slaves of others, and a capture of a scan, which has no write."""

from __future__ import annotations

import json
from contextlib import ExitStack
from typing import TYPE_CHECKING, Any

import pytest

import mbtool as api
from mbtool.devices import load_profile
from tests.end_to_end.peers import SIZE, UNIT, libmodbus_server, pymodbus_server, slave_of_another
from tests.end_to_end.programs import mbtool, run_mbtool
from tests.end_to_end.slaves_of_others import AREAS
from tests.end_to_end.test_troubles_of_real_masters import RawSlave, heard
from tests.end_to_end.test_watch_on_a_virtual_line import until

if TYPE_CHECKING:
    from pathlib import Path

TABLES = ("holding_registers", "input_registers", "coils", "discrete_inputs")


def scanned(*words: str) -> list[dict[str, Any]]:
    # A slave on a busy machine may take more than the 0.3 s that scan waits by itself.
    more = () if "--timeout" in words else ("--timeout", "2")
    text = run_mbtool("scan", *words, *more, "--format", "jsonl", "--rate", "2000")
    return [json.loads(line) for line in text.splitlines()]


def areas_in(row: dict[str, Any]) -> dict[str, list[tuple[int, int]]]:
    areas: dict[str, list[tuple[int, int]]] = {table: [] for table in TABLES}
    for one in row["areas"]:
        areas[one["table"]].append((one["first"], one["last"]))
    return areas


@pytest.mark.parametrize("kind", AREAS)
def test_finds_all_that_a_slave_of_another_library_lets_read(kind: str) -> None:
    with slave_of_another(kind) as link:
        rows = scanned(link, "--units", "1..2", "--addresses", "0..999")
    found = {row["unit"]: areas_in(row) for row in rows}
    assert found.pop(UNIT) == AREAS[kind]
    # Some servers refuse requests to other units, and some answer for each unit.
    assert all(not any(areas.values()) or areas == AREAS[kind] for areas in found.values())


@pytest.mark.parametrize("scheme", ["rtu", "ascii", "tcp", "rtu+tcp"])
def test_finds_all_that_an_embedded_slave_lets_read(scheme: str) -> None:
    with ExitStack() as stack:
        if "tcp" in scheme:
            link, on = "", f"{scheme}:127.0.0.1:0"
        else:
            line = stack.enter_context(api.line(f"{scheme}@115200-8N1"))
            link, on = line.link(0), line.link(1)
        slave = stack.enter_context(mbtool("slave", "fa3-at1m8x", "--on", on, "--unit", "1"))
        where = slave.said.find(r"on (\S+); Ctrl-C ends")[1]
        (row,) = scanned(link or where, "--units", "1", "--addresses", "0..999")
    areas = load_profile("fa3-at1m8x").areas
    readable = {
        (area.table.value, area.first, min(area.last, 999))
        for area in areas
        if "r" in area.access.value
    }
    assert {(one["table"], one["first"], one["last"]) for one in row["areas"]} == readable


def test_what_is_found_becomes_a_profile(tmp_path: Path) -> None:
    profile = tmp_path / "server.toml"
    with slave_of_another("pymodbus-tcp") as link:
        scanned(link, "--units", str(UNIT), "--addresses", "0..999", "-o", str(profile))
    drafted = {
        area.table.value: [(area.first, area.last)] for area in load_profile(str(profile)).areas
    }
    assert drafted == AREAS["pymodbus-tcp"]


@pytest.mark.peers
@pytest.mark.parametrize("is_serial", [False, True])
def test_finds_all_that_a_libmodbus_server_has(tmp_path: Path, *, is_serial: bool) -> None:
    with ExitStack() as stack:
        if is_serial:
            line = stack.enter_context(api.line("rtu@19200-8N1"))
            stack.enter_context(libmodbus_server(tmp_path, line.ports[1]))
            link = line.link(0)
        else:
            link = f"tcp:127.0.0.1:{stack.enter_context(libmodbus_server(tmp_path))[0]}"
        (row,) = scanned(link, "--units", str(UNIT), "--addresses", "0..999")
    assert areas_in(row) == {table: [(0, SIZE - 1)] for table in TABLES}


def test_finds_the_units_of_a_line_and_writes_nothing(tmp_path: Path) -> None:
    log = tmp_path / "scan.mcap"
    with ExitStack() as stack:
        line = stack.enter_context(api.line(ends=3))
        stack.enter_context(RawSlave(line.ports[1], {2: 0.002, 7: 0.002}))
        stack.enter_context(heard(line.link(2), log))
        rows = scanned(line.link(0), "--units", "2,5,7", "--units-only")
    assert [row["unit"] for row in rows] == [2, 7]
    asked = list(api.open(log))
    assert {one.function for one in asked} <= {1, 2, 3, 4, 8, 0x2B}
    assert len(asked) >= 7


def test_a_capture_of_a_whole_scan_has_no_write(tmp_path: Path) -> None:
    log = tmp_path / "scan.mcap"
    with ExitStack() as stack:
        target = stack.enter_context(slave_of_another("pymodbus-tcp")).removeprefix("tcp:")
        tap = stack.enter_context(mbtool("sniff", f"tap:127.0.0.1:0={target}", "-w", str(log)))
        port = tap.said.find(r"tap:127\.0\.0\.1:(\d+)=")[1]
        scanned(f"tcp:127.0.0.1:{port}", "--units", str(UNIT), "--addresses", "0..999")
        assert tap.interrupt() == 130, tap.said.text
    asked = list(api.open(log))
    assert len(asked) > 50
    assert {one.function for one in asked} <= {1, 2, 3, 4, 8, 0x2B}


def test_what_was_found_is_printed_also_if_the_line_is_lost(tmp_path: Path) -> None:
    units = dict.fromkeys(range(2, 100), 0.002)
    with api.line(ends=2) as line, RawSlave(line.ports[1], units):
        words = ("--units", "2..200", "--units-only", "--timeout", "2", "--format", "jsonl")
        resumed = tmp_path / "kept"
        program = mbtool("scan", line.link(0), *words, "--resume", str(resumed))
        until(
            lambda: resumed.exists() and '"sign"' in resumed.read_text(),
            lambda: program.said.text,
        )
    with program:
        assert program.wait() == 3
    assert json.loads(program.printed.text.splitlines()[0])["unit"] in units
    assert program.said.text.count("\n") == 1


def test_says_that_nobody_answers(tmp_path: Path) -> None:
    with (
        api.line(ends=2) as line,
        mbtool("scan", line.link(0), "--units", "1..2", "--timeout", "0.05") as program,
    ):
        assert program.wait() == 1
    assert program.said.text == "no unit answered\n"


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (("tcp:10.0.0.0/8:502",), "16,777,216 hosts, at most 1,024"),
        (("tcp:10.0.0.0/99:502",), "write a network such as tcp:10.0.0.0/28:502"),
        (("tcp:127.0.0.1:1", "--units", "9..3"), "--units 9..3: write the smaller number first"),
        (("tcp:127.0.0.1:1", "--units", "x"), "--units: 'x' is no number"),
        (("tcp:127.0.0.1:1", "--addresses", "1,2"), "name one range, as in 0..9999"),
    ],
)  # fmt: skip
def test_wrong_usage_is_told(words: tuple[str, ...], told: str) -> None:
    with mbtool("scan", *words) as program:
        assert program.wait() == 2
    assert told in program.said.text


def refused(*words: str) -> str:
    with mbtool("scan", "tcp:127.0.0.1:1", *words) as program:
        assert program.wait() == 3
    assert program.said.text.count("\n") == 1
    return program.said.text


def test_a_file_that_no_scan_wrote_is_refused_whatever_it_is(tmp_path: Path) -> None:
    other, wrong, long = tmp_path / "other", tmp_path / "wrong", tmp_path / "long"
    other.write_text('{"link": "tcp:10.0.0.1:502"}')
    wrong.write_text('{"link": "tcp:127.0.0.1:1", "units": [{"unit": 300, "sign": ""}]}')
    with long.open("wb") as stream:
        stream.truncate(17 << 20)
    assert "a scan did not write it" in refused("--resume", str(wrong))
    assert "is longer than 16 MiB" in refused("--resume", str(long))
    assert "is of tcp:10.0.0.1:502" in refused("--resume", str(other))
    for name in (str(tmp_path), "/dev/full", "/dev/zero"):
        assert f"--resume {name}: is no regular file" in refused("--resume", name)


def test_a_scan_of_other_units_or_addresses_is_not_resumed(tmp_path: Path) -> None:
    kept = str(tmp_path / "kept")
    with pymodbus_server() as (port, _):
        link = f"tcp:127.0.0.1:{port}"
        first = scanned(link, "--units", "1", "--addresses", "0x0..0x1f", "--resume", kept)
        again = scanned(link, "--units", "1", "--addresses", "0..31", "--resume", kept)
        assert first == again
        assert {area["last"] for area in first[0]["areas"]} == {31}
        for words, told in (
            (("--units", "1..3"), "is with --units 1, and 1..3 is asked for"),
            (("--units", "1"), "is with --addresses 0..31, and 0..9999 is asked for"),
        ):
            with mbtool("scan", link, *words, "--resume", kept) as program:
                assert program.wait() == 3
            assert told in program.said.text
