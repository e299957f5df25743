"""What the commands say and count where a capture kept only the first bytes of packets."""

from __future__ import annotations

import csv
import io
import json
from typing import TYPE_CHECKING

import pytest

from mbtool.modbus import mbap_adu
from mbtool.workflows.shared.capture_parts import MissingParts
from mbtool.workflows.shared.recorded import PlayOptions, read_recorded
from tests.packets.building import Talk, cut, packet, pcap

if TYPE_CHECKING:
    from pathlib import Path

    from tests.cli.program import CommandLine

SNAPLEN = 14 + 20 + 20 + 12
"""Whole reads, and responses with their byte count and one register."""
LINE = "5 packets are cut (snaplen 66)"


@pytest.fixture
def whole(tmp_path: Path) -> Path:
    return written(tmp_path / "whole.pcap", 1500)


@pytest.fixture
def part(tmp_path: Path) -> Path:
    return written(tmp_path / "part.pcap", SNAPLEN)


def written(path: Path, snaplen: int) -> Path:
    """Five reads of ten registers, the third with an exception, and a write of ten registers."""
    talk = Talk()
    packets = talk.handshake()
    for number in range(5):
        packets.append(talk.request(mbap_adu(number, 1, bytes.fromhex("03 0000 000A"))))
        pdu = "83 02" if number == 2 else "03 14" + 10 * "1234"
        packets.append(talk.response(mbap_adu(number, 1, bytes.fromhex(pdu))))
    packets.append(talk.request(mbap_adu(9, 1, bytes.fromhex("10 0007 000A 14" + 10 * "0001"))))
    packets.append(talk.response(mbap_adu(9, 1, bytes.fromhex("10 0007 000A"))))
    path.write_bytes(pcap([cut(each, snaplen) for each in [*packets, *talk.goodbye()]]))
    return path


@pytest.mark.parametrize("format_", ["table", "jsonl", "csv"])
def test_decode_says_how_many_packets_are_cut(
    part: Path, whole: Path, format_: str, mbtool: CommandLine
) -> None:
    assert mbtool("decode", part, "--format", format_).err.splitlines()[-1] == LINE
    assert "cut" not in mbtool("decode", whole, "--format", format_).err


def test_decode_joins_what_is_cut(part: Path, mbtool: CommandLine) -> None:
    rows = [json.loads(line) for line in mbtool("decode", part, "--format", "jsonl").lines]
    assert [row["outcome"] for row in rows] == [
        *("not-captured", "not-captured", "exception", "not-captured", "not-captured"),
        "not-captured",
    ]
    read, write = rows[0], rows[-1]
    assert (read["unit"], read["function"], read["address"], read["quantity"]) == (1, 3, 0, 10)
    assert (len(read["request_raw"]), len(read["response_raw"])) == (24, 24)
    assert "response_values" not in read
    assert read["verdicts"] == write["verdicts"] == ["cut"]
    assert (write["address"], write["quantity"]) == (7, 10)
    assert "request_values" not in write
    assert all(row["retries"] == 0 and row["latency_ns"] == 1_000_000 for row in rows)
    cells = [*csv.DictReader(io.StringIO(mbtool("decode", part, "--format", "csv").out))]
    assert [cell["outcome"] for cell in cells] == [row["outcome"] for row in rows]


def test_the_table_says_which_half_is_cut(part: Path, mbtool: CommandLine) -> None:
    lines = mbtool("decode", part).lines
    assert sum("answer cut" in line for line in lines) == 4
    assert sum("request cut" in line for line in lines) == 1


def test_check_says_it_and_blames_nobody(part: Path, mbtool: CommandLine) -> None:
    said = mbtool("check", part)
    assert (said.code, said.err.splitlines()[0]) == (0, LINE)
    (refused,) = said.out.splitlines()
    assert refused.startswith("! unit 1 refuses 1 of its 6 requests (17 %), with 02 illegal data ")


def test_a_cut_umas_request_is_no_command(tmp_path: Path, mbtool: CommandLine) -> None:
    file = tmp_path / "umas.pcap"
    talk = Talk()
    packets = [*talk.handshake(), talk.request(mbap_adu(1, 1, bytes.fromhex("5A 00 41 0000")))]
    file.write_bytes(pcap(packets))
    assert "SEC-103" in mbtool("check", file).out
    file.write_bytes(pcap([*packets[:-1], cut(packets[-1], SNAPLEN - 3)]))
    assert "SEC-103" not in mbtool("check", file).out


def test_diff_says_it_and_compares_only_what_is_whole(
    part: Path, whole: Path, mbtool: CommandLine
) -> None:
    said = mbtool("diff", part, part)
    assert said.code == 0
    assert said.err.splitlines()[:2] == [f"{part}: {LINE}"] * 2
    said = mbtool("diff", whole, part)
    assert f"{part}: {LINE}" in said.err.splitlines()


def test_replay_says_it_and_plays_only_what_is_whole(part: Path) -> None:
    remarks: list[str] = []
    read_recorded(str(part), PlayOptions(), remarks.append)
    assert remarks == [LINE]


@pytest.mark.parametrize(
    ("kept", "said"),
    [
        ([60, 100], []),
        ([40, 100], ["1 packet is cut (snaplen 40)"]),
        ([40, 40], ["2 packets are cut (snaplen 40)"]),
        ([40, 50], ["2 packets are cut"]),
        ([50, 40], ["2 packets are cut"]),
    ],
)
def test_the_snapshot_length_is_named_if_all_have_the_same(
    kept: list[int], said: list[str]
) -> None:
    missing = MissingParts()
    for length in kept:
        missing.note_item(cut(packet(bytes(60)), length))
    assert missing.remarks == said
