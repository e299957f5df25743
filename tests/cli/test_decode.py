"""mbtool decode: exact text, formats, and what chooses what is printed."""

from __future__ import annotations

import csv
import json
import os
import re
import signal
from dataclasses import replace
from threading import Thread
from typing import TYPE_CHECKING, Any

import jsonschema
import pytest

from mbtool.cli import exit_codes
from mbtool.logs import LogWriter, csv_columns, json_schema
from mbtool.logs.schemas import TRANSACTION
from mbtool.modbus import ascii_adu
from tests.cli.program import Program
from tests.logs.samples import EVENT, NAMED, transaction, write_log
from tests.packets.building import packet, pcap
from tests.workflows.evidence import capture_file, captured, damaged_log

if TYPE_CHECKING:
    from pathlib import Path

    from mbtool.core import Packet
    from tests.cli.program import CommandLine

TABLE = """\
1970-01-01 UTC
    # time             ms link            unit  request -> response
    1 00:00:00.004    1.0 10.0.0.2           1  03 read holding 0..1 -> 4660, 22136
    2 00:00:00.006    1.0 10.0.0.2           1  03 read holding 0..1 -> 4660, 22136
    3 00:00:00.008    1.0 10.0.0.2           1  03 read holding 0..1 -> 4660, 22136
"""


def _jsonl(text: str) -> list[dict[str, Any]]:
    return [json.loads(line) for line in text.splitlines()]


def _unknown(packets: list[Packet]) -> list[Packet]:
    """Packets of a link type that nobody knows."""
    return [replace(packet, link_type=9999) for packet in packets]


def test_prints_a_table_and_says_what_it_was(mbtool: CommandLine, capture: Path) -> None:
    told = mbtool("decode", capture)
    assert told.code == exit_codes.DONE
    assert told.out == TABLE
    assert told.err == "3 transactions: 3 ok\n"


def test_names_what_a_device_says(mbtool: CommandLine, capture: Path) -> None:
    told = mbtool("decode", capture, "--device", "10.0.0.2=idec-ft1a-touch", "--limit", 1)
    assert "03 read HR400001..400002 -> 4660, 22136" in told.out


def test_says_which_device_is_not_there(mbtool: CommandLine, capture: Path) -> None:
    told = mbtool("decode", capture, "--device", "9=wago-750", "--device", "all=fa3-at1m8x")
    assert "--device 9=wago-750: has no effect, as no such slave is there" in told.err
    assert "fa3-at1m8x" not in told.err
    cut_short = mbtool("decode", capture, "--device", "9=wago-750", "--limit", 1)
    assert "no effect" not in cut_short.err


def test_each_json_line_agrees_with_the_logs_schema(mbtool: CommandLine, tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    write_log(path, [NAMED, transaction(1), EVENT])
    schema = json.loads(json_schema(TRANSACTION))
    told = mbtool("decode", path, "--format", "jsonl")
    lines = _jsonl(told.out)
    assert len(lines) == 2
    for line in lines:
        jsonschema.validate(line, schema)
        assert line["response_raw"] == line["response_raw"].lower()
    assert lines[0]["points"][1] == {
        "name": "level",
        "reference": "HR400002",
        "value": 2.5,
        "text": "2.5 m",
        "unit": "m",
    }


def test_csv_has_a_row_for_each_and_reads_back(mbtool: CommandLine, capture: Path) -> None:
    told = mbtool("decode", capture, "--format", "csv")
    rows = list(csv.DictReader(told.lines))
    assert list(rows[0]) == list(csv_columns())
    assert [row["response_values"] for row in rows] == ["4660 22136"] * 3
    assert [row["outcome"] for row in rows] == ["ok"] * 3


def test_stops_at_a_limit(mbtool: CommandLine, capture: Path) -> None:
    told = mbtool("decode", capture, "--limit", 2)
    assert told.out == "".join(TABLE.splitlines(keepends=True)[:4])
    assert told.err == "2 transactions: 2 ok\n"


def test_prints_only_what_is_wanted(mbtool: CommandLine, tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    write_log(path, [transaction(unit=unit) for unit in (1, 2, 3, 2)])
    told = mbtool("decode", path, "--where", "unit == 2", "--format", "jsonl")
    assert [line["unit"] for line in _jsonl(told.out)] == [2, 2]


def test_a_row_has_the_number_that_it_has_in_the_capture(
    mbtool: CommandLine, tmp_path: Path
) -> None:
    path = tmp_path / "a.mcap"
    write_log(path, [transaction(unit=unit) for unit in (1, 2, 3, 2)])
    told = mbtool("decode", path, "--where", "unit == 2")
    assert [line.split()[0] for line in told.lines[2:]] == ["2", "4"]


def test_sorts_the_slowest_first_before_the_limit(mbtool: CommandLine, tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    write_log(path, [transaction(latency_ns=each) for each in (None, 0, 5, 3, 4)])
    told = mbtool("decode", path, "--sort", "latency", "--limit", 4, "--format", "jsonl")
    assert [line["latency_ns"] for line in _jsonl(told.out)] == [5, 4, 3, 0]


@pytest.mark.parametrize("key", ["time", "link", "unit", "function", "address"])
def test_sorts_the_least_first(mbtool: CommandLine, tmp_path: Path, key: str) -> None:
    path = tmp_path / "a.mcap"
    many: list[dict[str, Any]] = [
        {"request_ns": at, "link": f"l{at}", "unit": at, "function": at, "address": at}
        for at in (3, 1, 2)
    ]
    write_log(path, [transaction(**one) for one in many])
    told = mbtool("decode", path, "--sort", key, "--format", "jsonl")
    assert [line["unit"] for line in _jsonl(told.out)] == [1, 2, 3]


@pytest.mark.parametrize(
    ("options", "error"),
    [
        (["--columns", "time,size"], "--columns: there is no column 'size'; there are number, "),
        (["--hex", "--format", "jsonl"], "--time, --columns, --hex, --wide and --full go with"),
    ],
)
def test_a_wrong_choice_for_the_table_is_refused(
    mbtool: CommandLine, capture: Path, options: list[str], error: str
) -> None:
    told = mbtool("decode", capture, *options)
    assert (told.code, told.out) == (exit_codes.USAGE, "")
    assert error in told.err


def test_columns_and_values_are_those_that_were_chosen(mbtool: CommandLine, capture: Path) -> None:
    told = mbtool("decode", capture, "--columns", "master, id", "--hex", "--limit", 1)
    assert told.lines[1].split()[:2] == ["master", "id"]
    assert told.lines[2].endswith("03 read holding 0..1 -> 1234H, 5678H")


@pytest.mark.parametrize(
    ("events", "kinds"),
    [
        ([], []),
        (["--events", "none"], []),
        (["--events", "trouble"], ["gap"]),
        (["--events", "all"], ["opened", "gap", "closed"]),
    ],
)
def test_prints_the_events_that_are_asked_for(
    mbtool: CommandLine, tmp_path: Path, events: list[str], kinds: list[str]
) -> None:
    path = tmp_path / "a.pcap"
    packets = captured(3)
    del packets[5]  # A request is missing from the capture.
    path.write_bytes(pcap(packets))
    told = mbtool("decode", path, "--format", "jsonl", *events)
    found = [line["kind"] for line in _jsonl(told.out) if "kind" in line]
    assert [kind for kind in found if kind != "skipped"] == kinds


def test_a_table_shows_trouble(mbtool: CommandLine, tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    write_log(path, [EVENT])
    told = mbtool("decode", path)
    assert "gap: 60 bytes are missing" in told.out
    assert told.err == "0 transactions; 1 event: 1 gap\n"


def test_reads_parts_in_their_order(mbtool: CommandLine, tmp_path: Path) -> None:
    packets = captured(3)
    (tmp_path / "a.pcap").write_bytes(pcap(packets[:4]))
    (tmp_path / "b.pcap").write_bytes(pcap(packets[4:]))
    assert mbtool("decode", tmp_path / "a.pcap", tmp_path / "b.pcap").out == TABLE


def test_prints_what_comes_before_a_cut(mbtool: CommandLine, capture: Path) -> None:
    capture.write_bytes(capture.read_bytes()[:-1])
    told = mbtool("decode", capture)
    assert told.code == exit_codes.UNREADABLE
    assert told.out == TABLE
    first, second = told.err.splitlines()
    assert first == "3 transactions: 3 ok"
    assert second.startswith(f"mbtool: {capture}: ")


@pytest.mark.parametrize("raw", [[], ["--raw"]])
def test_prints_what_is_whole_of_a_damaged_log(
    mbtool: CommandLine, tmp_path: Path, raw: list[str]
) -> None:
    path = damaged_log(tmp_path / "a.mcap", 1)
    told = mbtool("decode", path, "--format", "jsonl", "--events", "all", *raw)
    assert told.code == exit_codes.UNREADABLE
    first, hole, last = _jsonl(told.out)
    assert (first["outcome"], hole["kind"], last["outcome"]) == ("ok", "gap", "ok")
    assert hole["link"] == ""
    counted, why = told.err.splitlines()
    assert counted == "2 transactions: 2 ok; 1 event: 1 gap"
    assert why.startswith(f"mbtool: {path}: damaged at byte ")
    assert why.endswith(
        " bytes of the log are left out, all else was read; mbtool recover makes a whole log of it"
    )


@pytest.mark.parametrize(
    ("data", "more", "why"),
    [
        (pcap([]), [], "empty; there is neither a packet nor a transaction in it"),
        (capture_file(), ["--port", "1502"], "no Modbus at TCP port 1502; --port any looks at all"),
    ],
)
def test_says_why_nothing_came(
    mbtool: CommandLine, tmp_path: Path, data: bytes, more: list[str], why: str
) -> None:
    path = tmp_path / "a.pcap"
    path.write_bytes(data)
    told = mbtool("decode", path, *more)
    assert (told.code, told.out) == (exit_codes.DONE, "")
    assert told.err.splitlines()[0] == "0 transactions"
    assert told.err.splitlines()[1].startswith(f"{path}: {why}")


@pytest.mark.parametrize("more", [[], ["--format", "jsonl"]])
def test_a_capture_of_which_nothing_can_be_read_is_an_error(
    mbtool: CommandLine, tmp_path: Path, more: list[str]
) -> None:
    path = tmp_path / "a.pcap"
    path.write_bytes(pcap(_unknown(captured(1))))
    told = mbtool("decode", path, *more)
    assert told.code == exit_codes.UNREADABLE
    assert told.err.splitlines()[-1] == (
        f"mbtool: {path}: nothing in it could be read: link type 9999 cannot be looked into"
    )


def test_a_capture_of_which_a_part_can_be_read_is_none(
    mbtool: CommandLine, tmp_path: Path, capture: Path
) -> None:
    path = tmp_path / "a.pcap"
    path.write_bytes(pcap(_unknown(captured(1))))
    assert mbtool("decode", path, capture).code == exit_codes.DONE


def test_a_file_is_read_once(mbtool: CommandLine, tmp_path: Path, capture: Path) -> None:
    (tmp_path / "other.pcap").symlink_to(capture)
    for again in (capture, tmp_path / "other.pcap"):
        told = mbtool("decode", capture, again)
        assert (told.code, told.out) == (exit_codes.USAGE, "")
        assert told.err == f"mbtool: {again}: named twice; what is in it would count twice\n"
    assert "-: named twice" in mbtool("decode", "-", "-").err


def test_reads_a_named_pipe(mbtool: CommandLine, tmp_path: Path, capture: Path) -> None:
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    writer = Thread(target=lambda: pipe.write_bytes(capture.read_bytes()))
    writer.start()
    told = mbtool("decode", pipe)
    writer.join()
    assert (told.code, told.out) == (exit_codes.DONE, TABLE)


def test_an_empty_name_is_wrong_usage(mbtool: CommandLine) -> None:
    told = mbtool("decode", "")
    assert told.code == exit_codes.USAGE
    assert told.err.startswith("mbtool: a file's name is empty; name a capture or a log")


def test_a_filter_that_nothing_passes_needs_no_reason(mbtool: CommandLine, capture: Path) -> None:
    assert mbtool("decode", capture, "--where", "unit == 9").err == "0 transactions\n"


def test_reads_standard_input(capture: Path) -> None:
    with capture.open("rb") as stdin, Program("decode", "-", stdin=stdin.fileno()) as program:
        told = program.end()
    assert (told.code, told.out) == (exit_codes.DONE, TABLE)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_while_it_waits_for_input_ends_it_with_what_came(number: int) -> None:
    reading, writing = os.pipe()
    with Program("decode", "-", "--format", "jsonl", stdin=reading) as program:
        os.close(reading)
        with os.fdopen(writing, "wb") as pipe:
            pipe.write(capture_file(500))
            pipe.flush()
            assert program.process.stdout is not None
            first = program.process.stdout.readline()
            told = program.end(number)
    assert told.code == exit_codes.INTERRUPTED
    lines = _jsonl(first + told.out)
    assert lines
    sum_ = rf"interrupted; so far {len(lines)} transactions?: {len(lines)} ok\n"
    assert re.match(sum_, told.err)


@pytest.mark.parametrize(("format_", "heading"), [("jsonl", 0), ("csv", 1), ("table", 2)], ids=str)
def test_a_live_capture_on_standard_input_is_shown_as_it_comes(format_: str, heading: int) -> None:
    packets = captured(3)
    reading, writing = os.pipe()
    with Program("decode", "-", "--format", format_, stdin=reading) as program:
        os.close(reading)
        assert program.process.stdout is not None
        with os.fdopen(writing, "wb", buffering=0) as pipe:
            whole, written = pcap(packets), 0
            for number in range(3):
                # The response is the last packet that has come, as far as the reader can know.
                so_far = len(pcap(packets[: 3 + 2 * (number + 1)]))
                pipe.write(whole[written:so_far])
                written = so_far
                for _ in range(1 if number else 1 + heading):
                    assert program.process.stdout.readline()
            pipe.write(whole[written:])
        told = program.end()
    assert (told.code, told.err) == (exit_codes.DONE, "3 transactions: 3 ok\n")
    assert told.out == ""


def test_follows_a_log_as_it_grows(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    log = LogWriter(path, capture={})
    log.write(transaction(1))
    log.tick(0)
    log.tick(10_000_000_000)
    with Program("decode", path, "--follow", "--format", "jsonl") as program:
        assert program.process.stdout is not None
        assert json.loads(program.process.stdout.readline())["unit"] == 1
        log.write(transaction(2, unit=2))
        log.tick(20_000_000_000)
        assert json.loads(program.process.stdout.readline())["unit"] == 2
        log.close()
        told = program.end()
    assert (told.code, told.err) == (exit_codes.DONE, "2 transactions: 2 ok\n")


def test_following_ends_with_ctrl_c(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    with LogWriter(path, capture={}) as log:
        log.write(transaction(1))
        log.tick(0)
        log.tick(10_000_000_000)
        with Program("decode", path, "--follow") as program:
            assert program.process.stdout is not None
            for _ in range(3):
                program.process.stdout.readline()
            told = program.end(signal.SIGINT)
    assert told.code == exit_codes.INTERRUPTED
    assert told.err == "interrupted; so far 1 transaction: 1 ok\n"


def test_a_capture_is_not_followed(mbtool: CommandLine, capture: Path) -> None:
    told = mbtool("decode", capture, "--follow")
    assert told.code == exit_codes.USAGE
    assert told.err == (f"mbtool: {capture}: not a log (.mcap); only a plain one can be followed\n")


@pytest.mark.parametrize(
    ("limit", "why"),
    [("x", "not a whole number"), ("1.5", "not a whole number"), ("0", "not at least 1")],
)
def test_a_limit_that_is_no_number_is_told_in_plain_words(
    mbtool: CommandLine, capture: Path, limit: str, why: str
) -> None:
    told = mbtool("decode", capture, "--limit", limit)
    said = f"mbtool: Invalid value for '--limit': '{limit}' is {why}; see mbtool decode --help\n"
    assert (told.code, told.err) == (exit_codes.USAGE, said)


def test_a_limit_hides_no_file_that_could_not_be_read(
    mbtool: CommandLine, tmp_path: Path, capture: Path
) -> None:
    told = mbtool("decode", tmp_path / "absent.pcap", capture, "--limit", 1)
    assert told.code == exit_codes.UNREADABLE
    assert len(told.out.splitlines()) == 3
    assert "1 transaction: 1 ok\n" in told.err
    assert told.err.endswith("absent.pcap: there is no such file\n")


def test_an_absent_input_leaves_an_older_output_alone(mbtool: CommandLine, tmp_path: Path) -> None:
    older = tmp_path / "older.jsonl"
    older.write_text("{}\n")
    told = mbtool("decode", tmp_path / "absent.pcap", "-o", older)
    assert told.code == exit_codes.UNREADABLE
    assert older.read_text() == "{}\n"


BYTES = "# a read\n01 03 00 00 00 02 c4 0b\n01 03 04 12 34 56 78 81 07\n"


def test_reads_the_bytes_of_a_line_that_is_named(mbtool: CommandLine, tmp_path: Path) -> None:
    path = tmp_path / "bench.txt"
    path.write_text(BYTES)
    told = mbtool("decode", path, "--link", "rtu@19200-8E1")
    assert told.code == exit_codes.DONE
    assert "bench              1  03 read holding 0..1 -> 4660, 22136" in told.out
    assert told.err == "1 transaction: 1 ok\n"


def test_bytes_in_text_need_no_line_if_they_are_frames(mbtool: CommandLine, tmp_path: Path) -> None:
    path = tmp_path / "bench.txt"
    path.write_text(BYTES)
    told = mbtool("decode", path)
    assert told.code == exit_codes.DONE
    assert "bench              1  03 read holding 0..1 -> 4660, 22136" in told.out
    assert told.err == (
        f"1 transaction: 1 ok\n{path}: 2 frames in 3 lines of text, all else passed over\n"
    )


def test_without_a_line_bytes_are_no_capture(mbtool: CommandLine, tmp_path: Path) -> None:
    path = tmp_path / "bench.txt"
    path.write_text(BYTES.replace("c4 0b", "c4 0c").replace("81 07", "81 08"))
    told = mbtool("decode", path)
    assert (told.code, told.out) == (exit_codes.UNREADABLE, "")
    assert told.err.startswith(f"mbtool: {path}: a text file of 3 lines, no capture; ")
    assert told.err.endswith("say which: --link rtu@19200-8E1\n")


def test_a_digit_too_few_is_one_line_with_its_row(mbtool: CommandLine, tmp_path: Path) -> None:
    path = tmp_path / "bench.txt"
    path.write_text(BYTES + "01 3\n")
    told = mbtool("decode", path, "--link", "rtu@19200-8E1")
    assert told.code == exit_codes.UNREADABLE
    assert told.err.splitlines()[-1].startswith(f"mbtool: {path}: row 4: '3' is not made of pairs")


@pytest.mark.parametrize("line", ["rtu:/dev/ttyUSB0@19200", "serial", "rtu@9600-7E1"])
def test_a_line_that_is_none_is_a_wrong_use(mbtool: CommandLine, capture: Path, line: str) -> None:
    told = mbtool("decode", capture, "--link", line)
    assert told.code == exit_codes.USAGE
    assert told.err.startswith(f"mbtool: --link {line!r}: ")
    assert len(told.err.splitlines()) == 1


def test_a_followed_log_has_lines_of_its_own(mbtool: CommandLine, tmp_path: Path) -> None:
    told = mbtool("decode", tmp_path / "a.mcap", "--follow", "--link", "rtu@9600")
    assert told.code == exit_codes.USAGE


def test_a_line_for_a_log_is_a_wrong_use_and_costs_no_older_output(
    mbtool: CommandLine, tmp_path: Path
) -> None:
    path, out = tmp_path / "a.mcap", tmp_path / "out.jsonl"
    write_log(path, [NAMED])
    out.write_text("older")
    told = mbtool("decode", path, "--link", "rtu@19200-8E1", "-o", out)
    assert told.code == exit_codes.USAGE
    assert told.err.startswith(f"mbtool: {path}: --link is not for a log")
    assert out.read_text() == "older"


def test_a_log_that_was_not_closed_is_told_and_no_error(
    mbtool: CommandLine, tmp_path: Path
) -> None:
    path, killed = tmp_path / "a.mcap", tmp_path / "killed.mcap"
    with LogWriter(path, capture={}) as log:
        log.write(transaction(1))
        log.tick(0)
        log.tick(10_000_000_000)
        killed.write_bytes(path.read_bytes())
    told = mbtool("decode", killed)
    assert told.code == exit_codes.DONE
    assert told.err.splitlines() == [
        "1 transaction: 1 ok",
        f"{killed}: was not closed; it ends at 2023-11-14 22:13:20.001 UTC",
    ]


def test_an_empty_file_of_a_line_is_an_empty_capture(mbtool: CommandLine, tmp_path: Path) -> None:
    path = tmp_path / "a.bin"
    path.write_bytes(b"")
    told = mbtool("decode", path, "--link", "rtu@9600")
    assert (told.code, told.out) == (exit_codes.DONE, "")
    assert told.err.splitlines() == ["0 transactions", f"{path}: no byte of a serial line in it"]


def test_packets_that_only_a_user_can_tell_of_are_read_as_the_error_says(
    mbtool: CommandLine, tmp_path: Path
) -> None:
    path = tmp_path / "a.pcap"
    path.write_bytes(pcap([packet(b"\1\3\0\0\0\2\xc4\x0b", 0, link_type=148)]))
    told = mbtool("decode", path)
    assert told.code == exit_codes.UNREADABLE
    advice = told.err.splitlines()[-1].rpartition("say which: ")[2]
    told = mbtool("decode", path, *advice.split())
    assert told.code == exit_codes.DONE
    assert told.err.startswith("1 transaction: ")


def test_what_a_line_is_taken_for_is_no_data(mbtool: CommandLine, tmp_path: Path) -> None:
    path = tmp_path / "a.pcap"
    path.write_bytes(pcap([packet(b"\1\3\0\0\0\2\xc4\x0b", 0, link_type=147)]))
    told = mbtool("decode", path)
    assert told.code == exit_codes.DONE
    assert "taken as" not in told.out
    assert told.err.count("taken as 19200-8E1; name the line with --link rtu@") == 1


def test_a_line_that_cannot_be_read_is_told_with_the_settings_that_fit(
    mbtool: CommandLine, tmp_path: Path
) -> None:
    path = tmp_path / "bench.txt"
    path.write_text(ascii_adu(1, bytes.fromhex("03 0000 0001")).hex() * 4)
    told = mbtool("decode", path, "--link", "rtu@9600-8N1")
    assert told.err.startswith(
        "mbtool: bench: of 68 bytes none can be read with rtu@9600-8N1, so the settings are "
        "probably wrong; ascii:PORT@9600-8N1 fits these bytes (9600-8N1 ASCII: 4 of 4 frames have "
        "a correct LRC)\n"
    )
    assert told.err.count("can be read") == 1


def test_rows_that_come_for_ever_are_not_sorted(mbtool: CommandLine, tmp_path: Path) -> None:
    told = mbtool("decode", tmp_path / "a.mcap", "--follow", "--sort", "latency")
    assert told.code == exit_codes.USAGE
    assert told.err.startswith("mbtool: --follow prints each row as it comes")


def test_a_file_named_after_another_format_is_told(
    mbtool: CommandLine, capture: Path, tmp_path: Path
) -> None:
    out = tmp_path / "a.jsonl"
    told = mbtool("decode", capture, "--format", "csv", "-o", out)
    assert told.code == exit_codes.DONE
    assert f"{out}: written as csv, as --format says, though its name ends in .jsonl\n" in told.err
    assert out.read_text().startswith("request_ns,")


@pytest.mark.parametrize("command", ["decode", "check", "inventory"])
def test_what_goes_to_standard_output_replaces_no_file(
    mbtool: CommandLine, capture: Path, command: str
) -> None:
    told = mbtool(command, capture, "--overwrite")
    assert (told.code, told.out) == (exit_codes.USAGE, "")
    assert told.err == "mbtool: --overwrite replaces a file, and none is named to write to\n"
