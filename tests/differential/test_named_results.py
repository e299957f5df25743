"""What `mbtool decode` makes of captures that others fail at, with a port named and with any."""

from __future__ import annotations

import csv
import json
from collections import Counter
from typing import TYPE_CHECKING, Any

import pytest

from tests.cli.program import CommandLine, Said

if TYPE_CHECKING:
    from pathlib import Path

PORTS = pytest.mark.parametrize("options", [(), ("--port", "any")], ids=["502", "any"])


@pytest.fixture
def decode(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, public_captures: Path
) -> Decode:
    return Decode(CommandLine(capsys, monkeypatch), public_captures)


class Decode:
    """Runs the command for a capture by its name."""

    def __init__(self, command: CommandLine, folder: Path) -> None:
        self._command = command
        self._folder = folder

    def path(self, name: str) -> Path:
        (path,) = self._folder.rglob(name)
        return path

    def __call__(self, name: str, *options: str) -> tuple[Said, list[dict[str, Any]]]:
        """What was said, and the transactions."""
        said = self._command("decode", self.path(name), "--format", "jsonl", *options)
        return said, [json.loads(line) for line in said.lines]


def adus(transactions: list[dict[str, Any]]) -> Counter[str]:
    return Counter(
        one[side] for one in transactions for side in ("request_raw", "response_raw") if side in one
    )


def without_packets(transactions: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """The transactions without times, and without what says in which packets they stand."""
    times = ("request_ns", "response_ns", "latency_ns", "time")
    left_out = (*times, "file", "request_packet", "response_packet")
    return [
        {key: value for key, value in one.items() if key not in left_out} for one in transactions
    ]


@pytest.mark.public_captures
@PORTS
@pytest.mark.parametrize(
    ("cut", "whole", "count"),
    [
        ("reseg5_suricata.pcap", "OISF__suricata-verify/tests__modbus__modbus.pcap", 39),
        ("reseg9_nopnop.pcap", "hist_50fa3d41__pcap__modbus.pcap", 467),
    ],
)
def test_payloads_cut_into_small_pieces_give_the_transactions_of_the_whole(
    decode: Decode, options: tuple[str, ...], cut: str, whole: str, count: int
) -> None:
    said, transactions = decode(cut, *options)
    assert said.code == 0
    assert adus(transactions).total() == count
    _, original = decode(whole)
    assert without_packets(transactions) == without_packets(original)


@pytest.mark.public_captures
@PORTS
def test_disorder_costs_only_the_adus_of_dropped_segments(
    decode: Decode, options: tuple[str, ...]
) -> None:
    name = "disorder_icsnpp.pcap"
    said, transactions = decode(name, *options)
    assert said.code == 0
    with decode.path(f"{name}.expected.csv").open(newline="") as file:
        truth = list(csv.DictReader(file))
    found = adus(transactions)
    assert found.total() == len(truth) == 48
    _, original = decode("testing__traces__modbus_example.pcap")
    assert not found - adus(original)


@pytest.mark.public_captures
@PORTS
@pytest.mark.parametrize(
    ("name", "count"),
    [
        ("testing__btest__Traces__ldap__ldap_invalid_credentials.pcap", 0),
        ("modbus-and-non-modbus-p502.pcap", 12),
    ],
)
def test_other_protocols_give_no_false_adu(
    decode: Decode, options: tuple[str, ...], name: str, count: int
) -> None:
    said, transactions = decode(name, *options)
    assert said.code == 0
    assert adus(transactions).total() == count


@pytest.mark.public_captures
@PORTS
def test_a_cut_file_gives_its_whole_packets_then_a_warning_and_exit_code_3(
    decode: Decode, options: tuple[str, ...]
) -> None:
    name = "cutfile_nopnop.pcap"
    said, transactions = decode(name, *options)
    assert said.code == 3
    assert adus(transactions).total() == 132
    *_, warning = said.err.splitlines()
    assert warning == (
        f"mbtool: {decode.path(name)}: ends in the middle of a record, after 361 whole packets"
    )


@pytest.mark.public_captures
@PORTS
def test_what_a_fuzzer_made_is_read_to_its_end(decode: Decode, options: tuple[str, ...]) -> None:
    said, transactions = decode("fuzz-72.pcap", *options)
    assert said.code == 0
    assert adus(transactions).total() == 23  # One of them is cut, one stands behind a gap.
    assert "Traceback" not in said.err
