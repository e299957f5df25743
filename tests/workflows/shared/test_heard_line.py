"""Whether a file's bytes went over the line that they are taken to have gone over."""

from __future__ import annotations

from mbtool.core import Chunk, EventKind, SerialFormat, WireEvent
from mbtool.workflows.shared.heard_line import HeardLine
from tests.workflows.evidence import MS, heard

SLOW = SerialFormat(300)
USUAL = SerialFormat()


def _doubt(format_: SerialFormat, *pieces: Chunk | WireEvent) -> str | None:
    line = HeardLine("a.pcap", format_)
    for piece in pieces:
        line.note(piece)
    return line.doubt


def test_a_line_of_which_no_byte_was_heard_is_told_apart() -> None:
    line = HeardLine("a.pcap", USUAL)
    line.note(WireEvent(ts_ns=0, link="if0", kind=EventKind.GAP, message=""))
    assert not line.has_bytes
    line.note(heard(0, b"\x03"))
    assert line.has_bytes


def test_packets_that_overlap_make_the_rate_doubtful() -> None:
    pieces = [heard(20 * number, b"\x03\0\0\0\2") for number in range(3)]
    assert _doubt(USUAL, *pieces) is None
    assert _doubt(SLOW, *pieces) == (
        "a.pcap: 2 of 3 packets overlap at 300 baud: is the rate right?"
    )


def test_back_to_back_is_no_overlap_not_even_by_a_character() -> None:
    data = bytes(8)
    for characters, is_doubtful in ((8, False), (7, False), (6, True)):
        last_ns = 1000 * MS + characters * USUAL.character_ns
        pieces = [Chunk(ts_ns=ns, link="a", data=data) for ns in (1000 * MS, last_ns)]
        assert (_doubt(USUAL, *pieces) is not None) is is_doubtful


def test_other_links_steps_back_and_events_are_no_overlap() -> None:
    first, second = heard(0, b"\x03"), heard(1, b"\x03", link="other")
    event = WireEvent(ts_ns=first.ts_ns, link=first.link, kind=EventKind.GAP, message="")
    assert _doubt(SLOW, event, first, event, second) is None
    assert _doubt(SLOW, heard(5, b"\x03"), heard(0, b"\x03")) is None
    assert _doubt(SLOW) is None
