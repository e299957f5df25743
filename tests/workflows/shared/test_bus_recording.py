"""The pieces of a line, from each kind of recording."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from mbtool.core import InputError, Packet, SerialLink, UsageError, parse_line, parse_link
from mbtool.modbus import ascii_adu, mbap_adu, rtu_adu
from mbtool.query.where import parse_where
from mbtool.replay import ByteRun, TimeRange
from mbtool.workflows.shared.bus_recording import MAX_PIECE, read_pieces
from mbtool.workflows.shared.reading import ReadingOptions
from mbtool.workflows.shared.recorded import PlayOptions
from tests.packets.building import Talk, pcap
from tests.workflows.evidence import READ, VALUES, capture_file

if TYPE_CHECKING:
    from collections.abc import Callable

    from mbtool.devices import NamedTransaction

OURS = Path(__file__).resolve().parents[3] / "captures"
CHARACTER_NS = 572_916
"""At 19200-8E1."""


def _line(text: str = "rtu:/dev/x@19200-8E1") -> SerialLink:
    link = parse_link(text)
    assert isinstance(link, SerialLink)
    return link


def _pieces(
    path: Path,
    *,
    options: ReadingOptions | None = None,
    wanted: Callable[[NamedTransaction], bool] = lambda _: True,
    window: TimeRange | None = None,
    link: SerialLink | None = None,
) -> tuple[list[ByteRun], list[str]]:
    told: list[str] = []
    pieces = read_pieces(
        str(path),
        PlayOptions(
            reading=options or ReadingOptions(), wanted=wanted, window=window or TimeRange()
        ),
        link or _line(),
        told.append,
    )
    return pieces, told


def test_a_log_of_a_line_gives_its_bytes_as_captured() -> None:
    pieces, told = _pieces(OURS / "torn-and-glued-frames.mcap")
    data = b"".join(piece.data for piece in pieces)
    wrong = bytes.fromhex("01 03 04 12 34 56 78 81 f8")
    assert (len(data), wrong in data, bytes.fromhex("00 ff") in data, told) == (139, True, True, [])
    assert pieces[0] == ByteRun(0, data[:1], after_silence=True)
    steps = [after.position_ns - before.position_ns for before, after in pairwise(pieces)]
    assert min(steps) > 0
    frame = rtu_adu(1, READ)
    assert data.startswith(frame)
    assert [piece.after_silence for piece in pieces[: len(frame) + 1]] == [
        True,
        *[False] * (len(frame) - 1),
        True,
    ]


def test_a_network_gives_frames_at_the_times_of_its_messages(tmp_path: Path) -> None:
    path = tmp_path / "a.pcap"
    path.write_bytes(capture_file(2))
    pieces, told = _pieces(path)
    assert [piece.data for piece in pieces] == [rtu_adu(1, READ), rtu_adu(1, VALUES)] * 2
    assert all(piece.after_silence for piece in pieces)
    assert pieces[0].position_ns == 0
    assert [piece.position_ns for piece in pieces] == sorted(piece.position_ns for piece in pieces)
    assert pieces[-1].position_ns > 0
    assert told == []


def test_an_ascii_line_gets_a_networks_messages_in_ascii(tmp_path: Path) -> None:
    path = tmp_path / "a.pcap"
    path.write_bytes(capture_file(1))
    pieces, _ = _pieces(path, link=_line("ascii:/dev/x@9600-7E1"))
    assert [piece.data for piece in pieces] == [ascii_adu(1, READ), ascii_adu(1, VALUES)]


def test_requests_that_were_open_at_once_go_one_after_the_other(tmp_path: Path) -> None:
    talk = Talk()
    packets = talk.handshake()
    packets += [talk.request(mbap_adu(number, 1, READ)) for number in (1, 2)]
    packets += [talk.response(mbap_adu(number, 1, VALUES)) for number in (2, 1)]
    path = tmp_path / "a.pcap"
    path.write_bytes(pcap(packets))
    pieces, _ = _pieces(path)
    assert [piece.data for piece in pieces] == [rtu_adu(1, READ), rtu_adu(1, VALUES)] * 2
    assert [piece.position_ns for piece in pieces] == sorted(piece.position_ns for piece in pieces)


def test_unit_0_is_told_to_be_a_broadcast() -> None:
    _, told = _pieces(OURS / "fa3-at1m8x-setup.pcap")
    assert [line.partition(": ")[2] for line in told] == [
        "unit 0 answers in it, but on a serial line unit 0 is a broadcast: "
        "listeners take its responses for unsolicited ones"
    ]


def test_a_window_is_counted_from_the_first_byte() -> None:
    path = OURS / "torn-and-glued-frames.mcap"
    whole, _ = _pieces(path)
    window = TimeRange(200_000_000, 600_000_000)
    part, _ = _pieces(path, window=window)
    assert [(one.position_ns + window.start_ns, one.data) for one in part] == [
        (one.position_ns, one.data) for one in whole if one.position_ns in window
    ]
    with pytest.raises(InputError, match="nothing to play in the part from 99 s on"):
        _pieces(path, window=TimeRange(99_000_000_000))


def test_bytes_without_times_follow_each_other_in_pieces_that_a_port_takes(tmp_path: Path) -> None:
    path = tmp_path / "bench.bin"
    data = (rtu_adu(1, READ) + rtu_adu(1, VALUES)) * 40
    path.write_bytes(data)
    options = ReadingOptions(line=parse_line("rtu@19200-8E1"))
    pieces, told = _pieces(path, options=options)
    assert b"".join(piece.data for piece in pieces) == data
    assert max(len(piece.data) for piece in pieces) == MAX_PIECE
    assert [piece.position_ns for piece in pieces] == [0, 256 * CHARACTER_NS, 512 * CHARACTER_NS]
    assert [line.partition(": ")[2] for line in told] == [
        "has no times of its bytes: they are sent without a silence"
    ]


def test_an_ascii_line_is_played_on_one_only() -> None:
    path = OURS / "ascii-line.mcap"
    pieces, _ = _pieces(path, link=_line("ascii:/dev/x@9600-7E1"))
    assert pieces[0].data[:1] == b":"
    with pytest.raises(UsageError, match=r"was recorded as .*; play it on ascii:/dev/x@9600-7E1"):
        _pieces(path)


def test_of_several_lines_one_is_to_be_chosen(tmp_path: Path) -> None:
    path = _two_lines(tmp_path / "two.mcap")
    with pytest.raises(UsageError, match=r"has several lines \(a, b\), and a bus is one; choose"):
        _pieces(path)
    pieces, _ = _pieces(path, wanted=parse_where("link == 'b'"))
    assert b"".join(piece.data for piece in pieces) == rtu_adu(2, READ) + rtu_adu(2, VALUES)


def test_a_line_from_standard_input_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    with (OURS / "torn-and-glued-frames.mcap").open("rb") as stream:
        monkeypatch.setattr("sys.stdin", _Standard(stream))
        with pytest.raises(
            UsageError, match="a recording of a serial line is read twice; name a file"
        ):
            _pieces(Path("-"))


class _Standard:
    """Standard input that is a file."""

    def __init__(self, buffer: object) -> None:
        self.buffer = buffer

    def isatty(self) -> bool:
        return False


def _two_lines(path: Path) -> Path:
    from mbtool.core import Chunk, Quiet
    from mbtool.decode.decoder import Decoder
    from mbtool.devices import Namer
    from mbtool.logs import LogWriter
    from tests.workflows.evidence import MS, START_NS, heard

    lines = {name: _line(f"rtu:/dev/{name}@19200-8E1") for name in ("a", "b")}
    decoder = Decoder(Namer(), lines=lines)
    with LogWriter(path, capture={}) as log:
        for unit, name in enumerate(lines, start=1):
            log.add_link(name, {"spec": str(lines[name])})
            items: list[Chunk | Quiet] = [
                heard(100 * unit, READ, unit, name),
                heard(100 * unit + 20, VALUES, unit, name),
                Quiet(START_NS + (100 * unit + 90) * MS, name),
            ]
            for item in items:
                if isinstance(item, Chunk):
                    log.write(item)
                for record in decoder.feed(item):
                    log.write(record)
    return path


def test_a_piece_that_seems_to_begin_before_the_one_it_follows_stays_behind_it(
    tmp_path: Path,
) -> None:
    """The rate is taken for too low: 89 characters would take 51 ms, and came 5 ms later."""
    asked, answer = rtu_adu(1, READ), rtu_adu(1, bytes.fromhex("03 54") + bytes(84))
    path = tmp_path / "a.pcap"
    packets = [
        Packet(ts_ns=at_ns, link="0", link_type=147, data=data, original_length=len(data))
        for at_ns, data in ((1_000_000_000, asked), (1_005_000_000, answer))
    ]
    path.write_bytes(pcap(packets))
    pieces, _ = _pieces(path)
    assert [(one.position_ns, one.data) for one in pieces] == [(0, asked), (0, answer)]
