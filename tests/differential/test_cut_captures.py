"""Public captures cut by a snapshot length, compared with the whole captures."""

from __future__ import annotations

import shutil
import subprocess
from collections import defaultdict
from dataclasses import replace
from typing import TYPE_CHECKING

import pytest

from mbtool.decode.decoder import Decoder
from mbtool.devices import NamedTransaction, Namer
from mbtool.modbus import Outcome, Verdict
from mbtool.modbus.adu import MBAP_BYTES
from tests.captures import public_folder, read_packets
from tests.cli.program import CommandLine
from tests.packets.building import cut, pcap
from tests.records import without_origins

if TYPE_CHECKING:
    from collections.abc import Iterable
    from pathlib import Path

    from mbtool.core import Packet

pytestmark = pytest.mark.public_captures

CAPTURES = (
    "digitalbond__Quickdraw-Snort/modbus_test_data_part1.pcap",
    "digitalbond__Quickdraw-Snort/modbus_test_data_part2.pcap",
    "derived/ipv6_iti_modbus_test.pcap",
    "kb221svs__modbus-anomaly-detection/modbus.pcap",
    "ntop__nDPI/modbus.pcap",
)
SNAPLENS = (62, 70, 96)


@pytest.fixture(params=CAPTURES)
def capture(request: pytest.FixtureRequest) -> Path:
    path: Path = public_folder() / request.param
    if not path.exists():
        pytest.skip(f"{path} is not there")
    return path


@pytest.fixture
def command_line(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> CommandLine:
    return CommandLine(capsys, monkeypatch)


def decoded(packets: Iterable[Packet]) -> list[NamedTransaction]:
    decoder = Decoder(Namer(), ports=(502,), across=True)
    records = [record for packet in packets for record in decoder.feed(packet)]
    records += decoder.close()
    return [record for record in records if isinstance(record, NamedTransaction)]


def at(transaction: NamedTransaction) -> tuple[str | None, int | None, int | None]:
    """What tells one request of a capture from another."""
    return transaction.source, transaction.request_ns, transaction.transaction_id


@pytest.mark.parametrize("snaplen", SNAPLENS)
def test_no_request_with_an_answer_is_told_as_unanswered(capture: Path, snaplen: int) -> None:
    packets = [replace(packet, link="if0") for packet in read_packets(capture)]
    whole = decoded(packets)
    part = decoded(cut(packet, snaplen) for packet in packets)
    silent = {at(one) for one in whole if one.outcome is Outcome.NO_ANSWER}
    assert {at(one) for one in part if one.outcome is Outcome.NO_ANSWER} <= silent
    assert not any(one.outcome is Outcome.UNSOLICITED for one in part) or any(
        one.outcome is Outcome.UNSOLICITED for one in whole
    )
    _demand_the_same_pairs(whole, part)


def _demand_the_same_pairs(whole: list[NamedTransaction], part: list[NamedTransaction]) -> None:
    """Each request whose unit and function are there has the response of the whole capture."""
    pairs = defaultdict(list)
    for one in whole:
        pairs[at(one)].append(one)
    for one in part:
        if one.request_raw is not None:
            assert any(_is_part_of(one, known) for known in pairs[at(one)])


def _is_part_of(one: NamedTransaction, known: NamedTransaction) -> bool:
    """True if a transaction of the cut capture tells nothing that the whole one does not tell."""
    if (one.unit, one.function) != (known.unit, known.function):
        return False
    for mine, other in (
        (one.request_raw, known.request_raw),
        (one.response_raw, known.response_raw),
    ):
        if mine is not None and (other is None or not other.startswith(mine)):
            return False
    if one.response_raw is not None and one.latency_ns != known.latency_ns:
        return False
    if (one.request_raw, one.response_raw) == (known.request_raw, known.response_raw):
        return one.outcome in (known.outcome, Outcome.NOT_CAPTURED)
    is_said = Verdict.CUT in one.verdicts or one.response_raw is None
    return is_said and (one.outcome, one.retries) == (Outcome.NOT_CAPTURED, 0)


def test_all_pairs_are_there_if_each_packet_has_its_function_code(capture: Path) -> None:
    """Cut behind the function code, whatever the headers before it take."""
    packets = [replace(packet, link="if0") for packet in read_packets(capture)]
    whole = decoded(packets)
    payloads = {raw for one in whole for raw in (one.request_raw, one.response_raw) if raw}
    short = [_cut_behind_function(packet, payloads) for packet in packets]
    assert sum(len(one.data) < one.original_length for one in short) > len(whole)
    part = decoded(short)
    assert {at(one) for one in part} == {at(one) for one in whole}
    for one, known in zip(sorted(part, key=_order), sorted(whole, key=_order), strict=True):
        assert (one.response_raw is None) is (known.response_raw is None)
        assert one.response_ns == known.response_ns


def _order(transaction: NamedTransaction) -> tuple[str, int]:
    return str(transaction.source), transaction.start_ns


def _cut_behind_function(packet: Packet, adus: set[bytes]) -> Packet:
    """Cut a packet that ends with an ADU behind the function code of that ADU."""
    for size in range(MBAP_BYTES + 2, 261):
        if packet.data[-size:] in adus:
            return cut(packet, len(packet.data) - size + MBAP_BYTES + 1)
    return packet


@pytest.mark.parametrize("format_", ["table", "jsonl", "csv"])
def test_one_line_tells_how_many_packets_are_cut(
    capture: Path, format_: str, tmp_path: Path, command_line: CommandLine
) -> None:
    packets = list(read_packets(capture))
    expected = sum(len(packet.data) > 62 for packet in packets)
    file = tmp_path / "cut.pcap"
    file.write_bytes(pcap([cut(packet, 62) for packet in packets]))
    noun = "packet is" if expected == 1 else "packets are"
    said = command_line("decode", file, "--format", format_)
    lines = [line for line in said.err.splitlines() if "cut (" in line]
    assert lines == [f"{expected:,} {noun} cut (snaplen 62)"]


@pytest.mark.skipif(shutil.which("editcap") is None, reason="needs editcap")
def test_what_editcap_cuts_reads_like_what_the_test_cuts(capture: Path, tmp_path: Path) -> None:
    file = tmp_path / "cut.pcapng"
    subprocess.run(["editcap", "-s", "96", str(capture), str(file)], check=True, timeout=60)
    cut_here = decoded(replace(cut(packet, 96), link="if0") for packet in read_packets(capture))
    cut_there = decoded(replace(packet, link="if0") for packet in read_packets(file))
    assert without_origins(cut_there) == without_origins(cut_here)
