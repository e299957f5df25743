"""mbtool convert."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from mbtool.cli import exit_codes
from mbtool.packets.segment import SYN
from tests.captures import read_packets
from tests.logs.samples import chunk, stock_messages, transaction, write_log

if TYPE_CHECKING:
    from tests.cli.program import CommandLine

CAPTURES = Path(__file__).resolve().parents[2] / "captures"
LINE = CAPTURES / "retry-after-silence.mcap"


def test_a_log_becomes_a_capture_and_a_log_again(mbtool: CommandLine, tmp_path: Path) -> None:
    shown, back = tmp_path / "x.pcapng", tmp_path / "x.mcap"
    told = mbtool("convert", LINE, shown)
    assert (told.code, told.out) == (exit_codes.DONE, "")
    assert told.err == f"7 packets -> {shown}\n"
    told = mbtool("convert", shown, back)
    assert told.err == f"57 reads, 4 transactions -> {back}\n"


def test_the_transactions_go_into_jsonl_and_back(mbtool: CommandLine, tmp_path: Path) -> None:
    first, log, second = (tmp_path / name for name in ("a.jsonl", "b.mcap", "c.jsonl"))
    assert mbtool("convert", LINE, first).code == exit_codes.DONE
    assert mbtool("convert", first, log).code == exit_codes.DONE
    assert mbtool("convert", log, second).code == exit_codes.DONE
    rows = [[*map(json.loads, path.read_text().splitlines())] for path in (first, second)]
    assert len(rows[0]) == 4
    for row in (*rows[0], *rows[1]):
        del row["file"]
    assert rows[0] == rows[1]


def test_a_mark_of_the_byte_order_before_the_first_transaction_is_no_fault(
    mbtool: CommandLine, tmp_path: Path
) -> None:
    lines = tmp_path / "a.jsonl"
    assert mbtool("convert", LINE, lines).code == exit_codes.DONE
    lines.write_bytes(b"\xef\xbb\xbf" + lines.read_bytes())
    assert mbtool("convert", lines, tmp_path / "b.mcap").code == exit_codes.DONE


def test_a_file_that_exists_is_replaced_only_if_that_is_wanted(
    mbtool: CommandLine, tmp_path: Path
) -> None:
    out = tmp_path / "x.pcapng"
    out.write_bytes(b"precious")
    told = mbtool("convert", LINE, out)
    assert told.code == exit_codes.USAGE
    assert out.read_bytes() == b"precious"
    assert mbtool("convert", LINE, out, "--overwrite").code == exit_codes.DONE
    assert out.read_bytes() != b"precious"


def test_what_is_left_of_a_cut_log_is_converted_and_the_exit_code_is_3(
    mbtool: CommandLine, tmp_path: Path
) -> None:
    log = write_log(tmp_path / "x.mcap", [chunk(1), transaction(1), chunk(2), transaction(2)])
    log.write_bytes(log.read_bytes()[:-200])
    for suffix in ("pcapng", "mcap", "jsonl"):
        out = tmp_path / f"out.{suffix}"
        assert mbtool("convert", log, out).code == exit_codes.UNREADABLE
        assert out.stat().st_size > 0


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["a.mcap"], "then the file to write"),
        (["no.mcap", "x.pcapng"], "no.mcap: there is no such file"),
        (["-", "x.pcapng"], "reads a file twice"),
        ([LINE, LINE, "x.pcapng"], "named twice"),
        ([LINE, LINE], "is an input"),
        (
            [LINE, "x.docx"],
            "its suffix names no format; let it end in .mcap, .pcap, .pcapng, .txt",
        ),
        ([LINE, "x.pcap"], "name it x.pcapng"),
        ([LINE, "x.pcapng", "--events", "all"], "--events goes with .jsonl"),
        ([LINE, "x.pcapng", "--link", "rtu@19200-8E1"], "--link is not for a log"),
    ],
)
def test_what_cannot_be_converted_is_one_clear_line(
    mbtool: CommandLine,
    arguments: list[object],
    said: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    told = mbtool("convert", *arguments)
    assert told.code in (exit_codes.USAGE, exit_codes.UNREADABLE)
    assert said in told.err
    assert told.err.startswith("mbtool: ")
    assert told.err.count("\n") == 1
    assert not [*tmp_path.iterdir()]


@pytest.mark.parametrize("line", ['{"what": 1}', '{"what": ' + "[" * 100_000])
def test_a_line_of_jsonl_that_is_no_transaction_is_told(
    mbtool: CommandLine, tmp_path: Path, line: str
) -> None:
    (tmp_path / "x.jsonl").write_text(f"{line}\n")
    told = mbtool("convert", tmp_path / "x.jsonl", tmp_path / "x.mcap")
    assert told.code == exit_codes.UNREADABLE
    assert "x.jsonl: line 1 is no transaction" in told.err


def test_a_line_of_jsonl_without_end_is_told(mbtool: CommandLine, tmp_path: Path) -> None:
    (tmp_path / "x.jsonl").write_text("{" + " " * (1 << 20))
    told = mbtool("convert", tmp_path / "x.jsonl", tmp_path / "x.mcap")
    assert told.code == exit_codes.UNREADABLE
    assert "x.jsonl: line 1 has more than 1048576 bytes" in told.err


def test_points_get_topics_of_their_own_only_where_asked(
    mbtool: CommandLine, tmp_path: Path
) -> None:
    plain, asked = tmp_path / "plain.mcap", tmp_path / "asked.mcap"
    source = [CAPTURES / "fa3-at1m8x-setup.pcap", "--device", "all=fa3-at1m8x"]
    assert mbtool("convert", source[0], plain, *source[1:]).code == 0
    assert mbtool("convert", source[0], asked, *source[1:], "--topic-per-point").code == 0
    own = [topic for topic, _, _ in stock_messages(asked) if topic.startswith("/points/")]
    assert own
    assert len(own) == sum(topic == "/points" for topic, _, _ in stock_messages(asked))
    assert not any(topic.startswith("/points/") for topic, _, _ in stock_messages(plain))
    told = mbtool("convert", source[0], tmp_path / "nameless.mcap", "--topic-per-point")
    assert "no point has a name, so none has a topic; name the devices: --device" in told.err
    told = mbtool("convert", plain, tmp_path / "x.jsonl", "--topic-per-point")
    assert (told.code, told.err.count("\n")) == (exit_codes.USAGE, 1)


PLANT = CAPTURES / "plant.pcap"


def test_each_slave_gets_a_file_with_its_whole_connections(
    mbtool: CommandLine, tmp_path: Path
) -> None:
    told = mbtool("convert", PLANT, tmp_path / "{device}.pcap")
    first, second = tmp_path / "10.0.0.11.pcap", tmp_path / "10.0.0.12.pcap"
    assert told.code == exit_codes.DONE
    assert told.err == f"50 packets -> {first}\n84 packets -> {second}\n"
    whole = list(read_packets(PLANT))
    parts = [list(read_packets(path)) for path in (first, second)]
    assert sorted(one.ts_ns for part in parts for one in part) == [one.ts_ns for one in whole]
    for part in parts:
        assert any(one.data[33] & SYN for one in part)
    joined = tmp_path / "joined.pcap"
    assert mbtool("convert", second, first, joined).code == exit_codes.DONE
    assert [one.data for one in read_packets(joined)] == [one.data for one in whole]
    assert _rows(mbtool, joined) == _rows(mbtool, PLANT)


def _rows(mbtool: CommandLine, path: Path) -> list[object]:
    rows = [json.loads(line) for line in mbtool("decode", path, "--format", "jsonl").lines]
    return [{key: row[key] for key in row if key != "file"} for row in rows]


def test_a_slave_of_a_serial_line_gets_a_file_by_its_unit(
    mbtool: CommandLine, tmp_path: Path
) -> None:
    told = mbtool("convert", LINE, PLANT, tmp_path / "x-{device}.mcap")
    assert told.code == exit_codes.DONE
    names = {path.name for path in tmp_path.iterdir()}
    assert names == {"x-10.0.0.11.mcap", "x-10.0.0.12.mcap", "x-rs485-unit1.mcap"}
    of_unit = mbtool("decode", tmp_path / "x-rs485-unit1.mcap", "--raw", "--format", "jsonl").lines
    assert len(of_unit) == 4


def test_a_cut_can_keep_the_whole_connections_of_what_it_chooses(
    mbtool: CommandLine, tmp_path: Path
) -> None:
    out = tmp_path / "x.pcap"
    chosen = ("--where", "function == 6")
    assert mbtool("convert", PLANT, out, *chosen).err == f"2 packets -> {out}\n"
    told = mbtool("convert", PLANT, out, *chosen, "--connections", "--overwrite")
    assert told.err == f"7 packets -> {out}\n"
    assert sum(bool(one.data[33] & SYN) for one in read_packets(out)) == 2


def test_a_name_with_device_is_for_captures_only(mbtool: CommandLine, tmp_path: Path) -> None:
    told = mbtool("convert", PLANT, tmp_path / "{device}.csv")
    assert told.code == exit_codes.USAGE
    assert "{device} goes with .mcap, .pcap, .pcapng" in told.err


def test_another_placeholder_than_the_device_is_refused(
    mbtool: CommandLine, tmp_path: Path
) -> None:
    told = mbtool("convert", PLANT, tmp_path / "{unit}.pcap")
    assert told.code == exit_codes.USAGE
    assert "{unit} stands for nothing; {device} is the name of the slave" in told.err
    assert not list(tmp_path.iterdir())
