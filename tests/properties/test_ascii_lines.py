"""What holds for ASCII lines as devices make them: other ends, parity bits, damage, silences."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from mbtool.core import Direction, SerialFormat
from mbtool.framing.skips import MAX_RUN
from mbtool.modbus import Adu, Skipped, ascii_adu
from mbtool.modbus.adu import MAX_ASCII_ADU, Transport, Verdict
from mbtool.modbus.pdu import pdu_of
from mbtool.serial_line import AsciiSplitter
from mbtool.serial_line.ascii import CHARACTER_TIMEOUT_NS
from tests.feeding import Line, feed_all
from tests.modbus.reading import adus, raw, skipped, with_parity
from tests.strategies import SIZES, UNIT, messages

FORMATS = st.sampled_from((SerialFormat(19200, 8, "N", 1), SerialFormat(19200, 7, "E", 1)))
ENDS = st.sampled_from((b"\r\n", b"\r\n", b"\r", b"\n", b"\r.", b"\r\x00", b"\r\r", b"\r0"))
PARITIES = st.sampled_from(("space", "even", "odd", "mark"))
SILENCES = st.sampled_from((
    0, 1, 5_000_000, CHARACTER_TIMEOUT_NS - 1, CHARACTER_TIMEOUT_NS, CHARACTER_TIMEOUT_NS + 1,
))  # fmt: skip
PDUS = st.one_of(
    messages().map(lambda each: each.pdu),
    st.sampled_from((b"\x08\x00\x03.\x00", b"\x08\x00\x03\r\x00", b"\x08\x00\x03:\x00")),
)
SPEAKERS = st.sampled_from((None, Direction.REQUEST, Direction.RESPONSE))


@st.composite
def frames(draw: st.DrawFn) -> bytes:
    """A frame whose LRC is right, written as devices write them."""
    frame = ascii_adu(draw(UNIT), draw(PDUS))[:-2]
    if draw(st.booleans()):
        frame = frame.lower()
    return with_parity(frame + draw(ENDS), draw(PARITIES))


@st.composite
def damaged(draw: st.DrawFn) -> bytes:
    """A frame cut, or with characters in place of others."""
    frame = bytearray(draw(frames()))
    for _ in range(draw(st.integers(0, 2))):
        frame[draw(st.integers(0, len(frame) - 1))] = draw(st.sampled_from(b":\r\n0.\xba\x8a\xff"))
    return bytes(frame[: draw(st.integers(0, len(frame)))])


@st.composite
def lines(draw: st.DrawFn) -> Line:
    """Frames, damage and noise, with silences of every kind between and inside them."""
    line = Line(draw(FORMATS))
    for _ in range(draw(st.integers(0, 6))):
        part = draw(st.one_of(frames(), damaged(), st.binary(max_size=9)))
        cut = draw(st.integers(0, len(part)))
        line.frame(part[:cut], draw(SILENCES)).frame(part[cut:], draw(SILENCES))
    return line


@given(lines(), SIZES, SPEAKERS, st.booleans())
def test_no_byte_is_lost_and_cutting_makes_no_difference(
    line: Line, sizes: list[int], speaker: Direction | None, timed: bool
) -> None:
    def splitter() -> AsciiSplitter:
        return AsciiSplitter(line.format, speaker=speaker, timed=timed)

    events = feed_all(splitter(), line.reads())
    assert raw(events) == line.data
    assert feed_all(splitter(), line.reads([1] * len(line.data))) == events
    assert feed_all(splitter(), line.reads(sizes)) == events


@given(lines(), st.data())
def test_learning_of_true_silences_makes_no_difference(line: Line, data: st.DataObject) -> None:
    events: list[Adu | Skipped] = []
    splitter = AsciiSplitter(line.format)
    ends = dict(line.silences())
    for part, ts_ns in line.reads():
        events += splitter.feed(part, ts_ns)
        if ts_ns in ends:
            for now_ns in sorted(data.draw(st.lists(st.integers(ts_ns, ends[ts_ns]), max_size=3))):
                events += splitter.advance(now_ns)
    assert events + splitter.close() == feed_all(AsciiSplitter(line.format), line.reads())


@given(
    st.lists(st.tuples(st.one_of(frames(), damaged()), st.integers(-(10**10), 10**10)), max_size=9),
    FORMATS,
    st.booleans(),
)
def test_no_byte_is_lost_whatever_the_clock_says(
    reads: list[tuple[bytes, int]], line: SerialFormat, timed: bool
) -> None:
    events = feed_all(AsciiSplitter(line, timed=timed), reads)
    assert raw(events) == b"".join(data for data, _ in reads)


@given(lines())
def test_no_more_is_held_than_a_frame_and_a_run_of_noise(line: Line) -> None:
    splitter, held = AsciiSplitter(line.format), 0
    for data, ts_ns in line.reads([1] * len(line.data)):
        held += len(data) - len(raw(splitter.feed(data, ts_ns)))
        assert held < MAX_ASCII_ADU + MAX_RUN


@given(
    st.lists(st.tuples(UNIT, PDUS, ENDS, st.booleans()), max_size=6),
    PARITIES,
    SIZES,
    SILENCES,
)
def test_every_frame_is_found_and_keeps_its_bytes(
    sent: list[tuple[int, bytes, bytes, bool]], parity: str, sizes: list[int], silence_ns: int
) -> None:
    line = Line(SerialFormat(19200, 8, "N", 1))
    for unit, pdu, end, lower in sent:
        characters = ascii_adu(unit, pdu)[:-2]
        frame = (characters.lower() if lower else characters) + end
        line.frame(with_parity(frame, parity), silence_ns)
    events = feed_all(AsciiSplitter(line.format), line.reads(sizes))
    assert skipped(events) == []
    heard = adus(events)
    assert [(adu.unit, adu.pdu) for adu in heard] == [(unit, pdu) for unit, pdu, _, _ in sent]
    for adu in heard:
        assert pdu_of(Transport.ASCII, adu.raw) == (adu.unit, adu.pdu)
        assert adu.checksum is not None
        assert adu.checksum.ok
        is_masked = any(byte > 0x7F for byte in adu.raw)
        assert (Verdict.PARITY_IN_DATA in adu.verdicts) == is_masked
