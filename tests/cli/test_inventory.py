"""mbtool inventory."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from mbtool.cli import exit_codes
from tests.workflows.evidence import capture_of

if TYPE_CHECKING:
    from tests.cli.program import CommandLine

CAPTURES = Path(__file__).resolve().parents[2] / "captures"
FA3 = CAPTURES / "fa3-at1m8x-setup.pcap"
LINE = CAPTURES / "ft1a-touch-line.mcap"
READ = (bytes.fromhex("03 0000 0002"), bytes.fromhex("03 04 1234 5678"))
WRITE = (bytes.fromhex("06 0010 0007"), bytes.fromhex("06 0010 0007"))


def test_a_network_is_a_table_of_units_and_masters(mbtool: CommandLine) -> None:
    told = mbtool("inventory", FA3)
    assert told.code == exit_codes.DONE
    refused, summary = told.err.splitlines()
    assert refused.startswith("! unit 0 refuses 03 holding 16..17 (once), with 02 illegal data ")
    assert summary == "1 host with 1 unit, 1 master in 9 transactions"
    assert [line.rstrip() for line in told.lines] == [
        "host       unit  role   profile",
        "127.0.0.1     0  slave  fa3-at1m8x 90",
        "      seen 2026-11-21 10:16:33, 9 transactions",
        '      says 42H model code "0016H"',
        "      fits fa3-at1m8x, by its model code and its answers",
        "      02 read discrete 9, 16..23; 2 times by 127.0.0.1",
        "      03 read holding; refused 16..17; once by 127.0.0.1",
        "      04 read input 2..9; once by 127.0.0.1",
        "      42 function 42H; once by 127.0.0.1",
        "      05 write coil 9; 2 times by 127.0.0.1",
        "      06 write register 258; once by 127.0.0.1",
        "      10 write registers 261..270; once by 127.0.0.1",
        "      exceptions: 02 illegal data address once",
        "",
        "master     asks  writes to  requests  seen",
        "127.0.0.1     1          1         9  2026-11-21 10:16:33",
    ]


def test_a_line_is_a_table_too_with_the_profile_that_its_log_names(mbtool: CommandLine) -> None:
    told = mbtool("inventory", LINE)
    assert told.lines[1].split() == ["rs485", "1", "slave", "idec-ft1a-touch", "(named)"]
    assert told.lines[2].strip().startswith("rtu, seen 2026-11-21 ")


def test_json_says_if_a_capture_is_cut(mbtool: CommandLine, tmp_path: Path) -> None:
    cut = tmp_path / "cut.pcap"
    cut.write_bytes(FA3.read_bytes()[:-5])
    told = mbtool("inventory", cut, "--format", "json")
    document = json.loads(told.out)
    (remark,) = document["remarks"]
    assert not document["is_whole"]
    assert told.err.endswith(f"mbtool: {remark}\n")
    document = json.loads(mbtool("inventory", FA3, "--format", "json").out)
    assert (document["is_whole"], document["remarks"]) == (True, [])


def test_the_format_follows_the_name_of_the_output(mbtool: CommandLine, tmp_path: Path) -> None:
    for name, begin in (
        ("a.json", "{"),
        ("a.csv", "host,port,unit"),
        ("a.txt", "host  "),
    ):
        assert mbtool("inventory", FA3, "-o", tmp_path / name).code == exit_codes.DONE
        assert (tmp_path / name).read_text().startswith(begin)


def test_the_same_as_the_baseline_is_exit_code_0(mbtool: CommandLine, tmp_path: Path) -> None:
    old = tmp_path / "old.json"
    mbtool("inventory", FA3, "-o", old)
    told = mbtool("inventory", FA3, "--baseline", old)
    assert (told.code, told.out) == (exit_codes.DONE, "")
    assert told.err.splitlines()[-1].startswith("0 changes since the baseline; 1 host ")


def test_what_is_new_since_the_baseline_is_printed_and_the_exit_code_is_1(
    mbtool: CommandLine, tmp_path: Path
) -> None:
    old, new = tmp_path / "old.pcap", tmp_path / "new.pcap"
    old.write_bytes(capture_of([READ] * 3))
    new.write_bytes(capture_of([READ, READ, WRITE]))
    told = mbtool("inventory", new, "--baseline", old)
    assert told.code == exit_codes.NO
    assert told.lines == [
        "new writer        10.0.0.2 unit 1  10.0.0.1: 06 write register writes 16"
    ]
    data = json.loads(mbtool("inventory", new, "--baseline", old, "--format", "json").out)
    assert [one["kind"] for one in data["changes"]] == ["new writer"]
    table = mbtool("inventory", new, "--baseline", old, "--format", "csv")
    assert table.lines[0].startswith("kind,host,port,unit,text")


@pytest.mark.parametrize("text", ["{", '{"x": ' + "[" * 100_000])
def test_a_baseline_that_is_no_inventory_is_one_line(
    mbtool: CommandLine, tmp_path: Path, text: str
) -> None:
    (tmp_path / "old.json").write_text(text)
    told = mbtool("inventory", FA3, "--baseline", tmp_path / "old.json")
    assert told.code == exit_codes.UNREADABLE
    assert told.err.count("\n") == 1
    assert "old.json: is no inventory as --format json writes it" in told.err


def test_a_file_that_is_absent_is_told(mbtool: CommandLine) -> None:
    assert mbtool("inventory", "absent.pcap").code == exit_codes.UNREADABLE


def test_the_filter_chooses_what_counts(mbtool: CommandLine) -> None:
    told = mbtool("inventory", FA3, "--where", "function == 4")
    assert "in 1 transaction" in told.err


def test_a_file_that_cannot_be_read_stops_no_other(mbtool: CommandLine, tmp_path: Path) -> None:
    notes = tmp_path / "notes.txt"
    notes.write_text("no capture")
    told = mbtool("inventory", FA3, notes)
    assert told.code == exit_codes.UNREADABLE
    assert told.lines[1].startswith("127.0.0.1     0  slave")
    assert "not read: " in told.err


def test_an_output_is_left_as_it_is_if_nothing_can_be_read(
    mbtool: CommandLine, tmp_path: Path
) -> None:
    out = tmp_path / "old.json"
    out.write_text("old")
    assert mbtool("inventory", "absent.pcap", "-o", out).code == exit_codes.UNREADABLE
    told = mbtool("inventory", FA3, "--baseline", "absent.pcap", "-o", out, "--overwrite")
    assert told.code == exit_codes.UNREADABLE
    assert out.read_text() == "old"
