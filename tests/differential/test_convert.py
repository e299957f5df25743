"""Serial lines in Wireshark without any setting: what tshark shows of converted recordings."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import pytest

from mbtool.core import WireEvent, parse_line
from mbtool.modbus import Outcome
from mbtool.workflows.convert import Conversion
from mbtool.workflows.shared.reading import Reading, ReadingOptions
from mbtool.workflows.shared.time_window import TimeWindow
from tests.captures import public_folder
from tests.differential.conversions import captures, compare
from tests.records import without_origins

if TYPE_CHECKING:
    from mbtool.devices import NamedTransaction

OWN = Path(__file__).resolve().parents[2] / "captures"
SIGROK = public_folder() / "sigrokproject__sigrok-dumps"
LINES = (
    *((one, None) for one in sorted(OWN.glob("*.mcap")) if "packets" not in one.stem),
    *(
        (SIGROK / f"{name}.{form}", line)
        for name, line in (
            ("brainchild-io-16do", "rtu@19200-8E1"),
            ("flowmeter_graph_tool", "rtu@9600-8E1"),
            ("flowmeter_target0_val0", "rtu@9600-8E1"),
            ("flowmeter_target_0liter_per_min", "rtu@9600-8E1"),
        )
        for form in ("bytes.csv", "rtac.pcap", "user0.pcap", "bus.bin")
    ),
    *((one, None) for one in sorted(SIGROK.glob("*.sr"))),
    (public_folder() / "derived" / "noisy_bus_flowmeter.bytes.csv", None),
    (public_folder() / "derived" / "noisy_bus_flowmeter.bus.bin", "rtu@9600-8N1"),
)
MAX_BYTES = 60_000
SMALL = [
    path
    for path in captures(public_folder())
    if path.stat().st_size <= MAX_BYTES and path.parent != SIGROK
]
"""Captures of networks; python -m tests.differential.conversions converts the large ones, too."""
FIELDS = (
    "udp.srcport",
    "frame.time_epoch",
    "mbtcp.trans_id",
    "mbtcp.unit_id",
    "modbus.func_code",
    "modbus.request_frame",
    "modbus.response_time",
    "udp.payload",
    "_ws.expert.message",
    "frame.comment",
)

needs_tshark = pytest.mark.skipif(shutil.which("tshark") is None, reason="needs tshark")


class _Frame(NamedTuple):
    """A frame as tshark shows it."""

    is_request: bool
    number: int
    unit: int
    function: int
    request_frame: int | None
    latency_ns: int | None
    raw: bytes
    ts_ns: int


def _ns(seconds: str) -> int:
    whole, _, fraction = seconds.partition(".")
    return int(whole) * 10**9 + int(fraction)


def _tshark(path: Path, *arguments: str) -> list[str]:
    command = ["tshark", "-r", str(path), *arguments]
    run = subprocess.run(command, capture_output=True, text=True, check=True)
    return run.stdout.splitlines()


def _shown(path: Path) -> dict[int, _Frame]:
    """The frames by the number of their packet; fails for an expert message that is no comment."""
    fields = [text for name in FIELDS for text in ("-e", name)]
    frames = {}
    for number, line in enumerate(_tshark(path, "-T", "fields", *fields), 1):
        source, time, trans, unit, function, request, latency, payload, *told = line.split("\t")
        if not source:
            continue  # Bytes that are no frame.
        assert told[0] == told[1], line  # A comment is an expert message, too.
        frames[number] = _Frame(
            source != "502",
            int(trans),
            int(unit),
            int(function),
            int(request) if request else None,
            _ns(latency) if latency else None,
            bytes.fromhex(payload),
            _ns(time),
        )
    return frames


def _converted(path: Path, line: str | None, out: Path) -> list[NamedTransaction]:
    options = ReadingOptions(line=None if line is None else parse_line(line))
    Conversion([str(path)], options, TimeWindow.parse(None, None)).write(str(out))
    records = Reading([str(path)], ReadingOptions(line=options.line, raw=path.suffix == ".mcap"))
    return [one for one in records.records() if not isinstance(one, WireEvent)]


@pytest.mark.peers
@needs_tshark
@pytest.mark.parametrize(("path", "line"), LINES, ids=lambda one: getattr(one, "name", None))
def test_tshark_shows_directions_pairs_and_latencies_as_mbtool_does(
    path: Path, line: str | None, tmp_path: Path
) -> None:
    if not path.exists():
        pytest.skip(f"{path} is not there")
    out = tmp_path / "x.pcapng"
    transactions = _converted(path, line, out)
    frames = _shown(out)
    by_side = {(one.number, one.is_request): number for number, one in frames.items()}
    expected = 0
    for number, one in enumerate(transactions, 1):
        number = one.transaction_id if one.transaction_id is not None else number
        for raw, is_request in ((one.request_raw, True), (one.response_raw, False)):
            if raw is None:
                continue
            expected += 1
            frame = frames[by_side[number, is_request]]
            assert (frame.unit, frame.function & 0x7F) == (one.unit, one.function)
            if raw[:1] != b":":
                assert frame.raw.endswith(raw)
        if one.outcome in (Outcome.OK, Outcome.EXCEPTION):
            request, response = (frames[by_side[number, side]] for side in (True, False))
            assert one.latency_ns in (None, response.ts_ns - request.ts_ns)
            if one.outcome is Outcome.OK:  # tshark joins no exception with its request.
                assert response.request_frame == by_side[number, True]
                assert one.latency_ns in (None, response.latency_ns)
    assert expected == len(frames) > 0


@pytest.mark.parametrize(("path", "line"), LINES, ids=lambda one: getattr(one, "name", None))
def test_a_serial_recording_comes_back_from_pcapng(
    path: Path, line: str | None, tmp_path: Path
) -> None:
    if not path.exists():
        pytest.skip(f"{path} is not there")
    out = tmp_path / "x.pcapng"
    transactions = without_origins(_converted(path, line, out))
    records = Reading([str(out)], ReadingOptions()).records()
    assert without_origins(one for one in records if not isinstance(one, WireEvent)) == transactions
    assert transactions


@pytest.mark.parametrize("path", SMALL, ids=lambda path: path.name)
def test_packets_made_by_others_come_back_one_by_one(path: Path, tmp_path: Path) -> None:
    result = compare(path, tmp_path)
    assert result.unlike == []
    assert result.ways >= 2


@pytest.mark.peers
@needs_tshark
def test_the_list_of_packets_names_master_and_slave(tmp_path: Path) -> None:
    out = tmp_path / "x.pcapng"
    _converted(OWN / "ft1a-touch-line.mcap", None, out)
    ends = _tshark(
        out, "-N", "n", "-T", "fields", "-e", "_ws.col.Source", "-e", "_ws.col.Destination"
    )
    assert set(ends) == {"master.rs485\tunit1.rs485", "unit1.rs485\tmaster.rs485"}


@pytest.mark.peers
@needs_tshark
def test_a_filter_finds_the_check_bytes_and_the_comments(tmp_path: Path) -> None:
    out = tmp_path / "x.pcapng"
    _converted(OWN / "torn-and-glued-frames.mcap", None, out)
    assert len(_tshark(out, "-Y", "udp.payload[-2:] == c4:0b")) == 8
    assert len(_tshark(out, "-Y", 'frame.comment contains "glued"')) == 3
    assert len(_tshark(out, "-Y", "frame.packet_flags_crc_error == 1")) == 1
