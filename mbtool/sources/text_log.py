"""Reads Modbus frames from text: the logs of other programs, terminals and analysers."""

# No program has special code here. A line is read in three steps: its time (text_marks.py), the
# places with bytes, and the word or arrow before the bytes that names the
# sender. A line without such a mark uses the mark of an earlier line, at most LOOK_BACK lines
# before; the rows of a dump use that of its heading. text_frames.py decides which bytes are a
# Modbus frame, and its direction. All other text is skipped and counted.
#
# Lines that differ only in hexadecimal digits have one shape. The places found in a shape are kept,
# because programs write the same few kinds of lines again and again. So a line with a known shape
# costs one look-up in a dictionary.
#
# RTU and ASCII frames are of one serial line, frames with an MBAP header of one TCP connection;
# both have the name of the file. A log has times if one of its first MAX_UNTIMED frames has one. In
# a log with times, a frame without a time has the time of the frame before it; frames before the
# first time have that first time. Threads write their lines a little out of order, so a time that
# goes back by less than MAX_BACK_NS is replaced by the time of the frame before. In a log without
# times, invented times show the order: as if the bytes had come without gaps at the line's baud
# rate, from 1970-01-01 on.
#
# Memory: lines of at most MAX_LINE bytes, MAX_SHAPES shapes, MAX_UNTIMED frames, and that of
# text_frames.py.

from __future__ import annotations

import codecs
import re
from bisect import bisect_left
from collections import deque
from collections.abc import Callable, Iterator
from itertools import chain
from typing import TYPE_CHECKING, BinaryIO, NamedTuple, cast

from mbtool.core import (
    Chunk,
    Connection,
    Direction,
    Endpoint,
    EventKind,
    Origin,
    SerialFormat,
    Stamp,
    StreamPlace,
    WireEvent,
)
from mbtool.core.limits import MODBUS_PORT
from mbtool.core.moments import DAY_NS
from mbtool.modbus.adu import Transport
from mbtool.packets.stream_events import StreamGap
from mbtool.sources.text_frames import Label, TextFrame, TextFrames
from mbtool.sources.text_marks import (
    MAX_TIME_NS,
    DateOrder,
    Mark,
    Time,
    bracket_mark,
    find_mark,
    find_time,
)

if TYPE_CHECKING:
    import io


# The code below finds bytes in a line of text, in every notation that programs use.
#
# The shape of a line is the line with 0 in place of every hexadecimal digit. So a pattern needs no
# classes of digits, and lines that differ only in digits have one shape, whose places are found
# only once. NOTATIONS is the whole list; a new notation is one row.
#
# If two notations find bytes at overlapping places, the one with more bytes wins. Text in quotes
# with escapes (\x01, \1, \n) and lists of decimal numbers are read from the line itself.

SHAPE = bytes.maketrans(b"123456789abcdefABCDEF", b"0" * 21)
"""The table for bytes.translate that turns a line into its shape."""
MIN_PURE = 4
"""Bytes in equal pairs (01 03) are preferred to groups (0103 0000) from this many bytes on."""
DUMP_ROW = 16
"""The number of bytes in a row of a dump; what follows is its column of characters."""

_BEFORE = rb"(?<![0-9A-Za-z_.])"
_AFTER = rb"(?![0-9A-Za-z_])"
_PUNCTUATION = bytes(set(range(128)) - set(b"0123456789abcdefABCDEF"))
_OFFSET = re.compile(rb"[^0]{0,3}\b(?:0x)?(?:0{4}|0{6,8}|0{10,12})(?::|h|\t| | \|) {0,3}(?=00)")
"""The offset at the front of a row of a dump: hexdump -C, xxd, Wireshark, tcpdump, `0000 | `."""


class FoundBytes(NamedTuple):
    """A place in a line at which bytes are written."""

    start: int
    end: int
    read: Callable[[bytes], bytes]
    """Reads the bytes from the text of the place. Raises ValueError if they are none."""
    is_row: bool = False
    """True if the line is a row of a dump, with an offset at its front."""


class Notation(NamedTuple):
    """A way to write bytes: how it looks in a shape, and how to read it."""

    hints: tuple[bytes, ...]
    """Texts of which one is in the shape wherever the pattern is. Looking for them is quick."""
    pattern: re.Pattern[bytes]
    read: Callable[[bytes], bytes]


_LETTERS = {
    b"n": b"\n", b"r": b"\r", b"t": b"\t", b"a": b"\a", b"b": b"\b", b"f": b"\f", b"v": b"\v",
    b"e": b"\x1b",
}  # fmt: skip


def _digits(text: bytes) -> bytes:
    return bytes.fromhex(text.translate(None, _PUNCTUATION).decode())


_VALUES = {
    f"{value:{width}}".encode(): value for value in range(256) for width in ("x", "X", "02x", "02X")
}
_SPACES = bytes.maketrans(b",;:\t", b"    ")


def _prefixed(text: bytes) -> bytes:
    words = text.translate(_SPACES).replace(b"0x", b" ").replace(b"0X", b" ").split()
    try:
        return bytes(map(_VALUES.__getitem__, words))
    except KeyError:
        return bytes(int(word, 16) for word in words)


def _decimal(text: bytes) -> bytes:
    numbers = re.findall(rb"\w+", text)
    if all(len(each) == 2 for each in numbers) or any(each[:1] == b"0" != each for each in numbers):
        raise ValueError("hexadecimal digits in pairs")
    return bytes(map(int, numbers))


def _slashed(text: bytes) -> bytes:
    return b"".join(
        _LETTERS[each] if each in _LETTERS else bytes.fromhex(each.decode())
        for each in text.split(b"\\")[1:]
    )


def _ascii_frame(text: bytes) -> bytes:
    return text + b"\r\n"


def _parse_long_digits(text: bytes) -> bytes:
    if text[:2] == b"0b" and not text[2:].strip(b"01"):
        raise ValueError("a binary number")
    return _digits(text[2:] if text[1:2] in b"xX" else text)


NOTATIONS = (
    # 0x1 0x3, 0x01,0x03, 0x01 0x03
    Notation(
        (b"0x0", b"0X0"),
        re.compile(_BEFORE + rb"0[xX]00?(?:[ \t,;:]{0,3}0[xX]00?)*" + _AFTER),
        _prefixed,
    ),
    # [01][03], <01><03>, \x01\x03
    Notation((b"[00]",), re.compile(rb"(?:\[00\][ ,]?)+"), _digits),
    Notation((b"<00>",), re.compile(rb"(?:<00>[ ,]?)+"), _digits),
    Notation((b"\\x00",), re.compile(rb"(?:\\x00 ?)+"), _digits),
    # \\00\\01\\n, pairs of digits behind a backslash
    Notation((b"\\00\\00",), re.compile(rb"(?:\\(?:00(?!0)|[nrt])){4,}"), _slashed),
    # 01 03, 01:03, 01-03, 01,03, 01, 03, with a second space behind the eighth byte of a dump
    Notation(
        (b"00 00", b"00  00", b"00, 00", b"00,00", b"00:00", b"00-00", b"00|00", b"00;00",
         b"00_00", b"00\t00"),
        re.compile(
            _BEFORE + rb"00(?:(?: {1,2}00)+|(?:, ?00)+|(?::00)+|(?:-00)+|(?:\|00)+|(?:;00)+"
            rb"|(?:_00)+|(?:\t00)+)" + _AFTER
        ),
        _digits,
    ),
    # 01.03.00.00.00.0A, at least five, as an IP address has four
    Notation(
        (b"00.00.00",), re.compile(_BEFORE + rb"00(?:\.00){4,}(?![0-9A-Za-z_]|\.0)"), _digits
    ),
    # 01h 03h, 01H,03H
    Notation(
        (b"00h", b"00H"),
        re.compile(_BEFORE + rb"00[hH](?:[ ,]{0,2}00[hH])+" + _AFTER),
        _digits,
    ),
    # :0103000000025A, a frame of Modbus ASCII as it is
    Notation((b":00000000",), re.compile(rb":(?:00){4,}" + _AFTER), _ascii_frame),
    # 581#01030400010002, a CAN frame that carries a part of a Modbus frame
    Notation((b"000#00",), re.compile(rb"(?<=[ 0]000#)(?:00){1,8}" + _AFTER), _digits),
    # 0103000000020BC4, 0x0103000000020BC4
    Notation(
        (b"00000000",),
        re.compile(_BEFORE + rb"(?:0[xX])?(?:00){4,}[hH]?" + _AFTER),
        _parse_long_digits,
    ),
)  # fmt: skip
_GROUPS = Notation(
    (b"0000 00", b"00 0000"),
    re.compile(_BEFORE + rb"(?:00)+(?: (?:00)+)+" + _AFTER),
    _digits,
)
"""0103 0000 0002 0BC4: xxd, and bytes grouped by fields."""
_DECIMALS = Notation(
    (b"0, 0", b"0,0", b"0 0"),
    re.compile(rb"[\[({]\s?0{1,3}(?:[, ]\s?0{1,3}){3,}\s?[\])}]"),
    _decimal,
)
"""[1, 3, 0, 0, 0, 2, 196, 11]: Python, JavaScript, Go."""
_BARE_DECIMALS = Notation(
    (b"0, 0", b"0-0"),
    re.compile(rb"(?<=[:>-] )0{1,3}(?:(?:, 0{1,3}){3,}|(?:-0{1,3}){3,})(?=\s*$)"),
    _decimal,
)
"""TX: 1, 3, 0, 22, 0, 2, 37, 207 and -> 1-3-0-22-0-2-37-207 at the end of a line: NModbus,
modbus-tk."""
_SINGLE = re.compile(rb"(?:[:=>\]]\s{0,2}|^\s*)(00)(?:\s{3,}\S{1,3})?\s*$")
"""A single byte at the end of a line, as programs write that log each byte; or in a row of its own,
with its character behind it."""
_QUOTED = re.compile(rb"\"((?:[^\"\\]|\\.)*)\"|'((?:[^'\\]|\\.)*)'")
_CODED = re.compile(rb"\\[xu0-7]|^:[0-9A-Fa-f]{8,}\\r")
"""A text in quotes may be bytes if it has an escape with digits, or is a frame of Modbus ASCII."""
_CALL = re.compile(rb"\b\w+\(\d+, $")
"""The text that strace writes in front of the bytes that a call reads or writes."""
_ESCAPE = re.compile(rb"\\(?:x([0-9A-Fa-f]{2})|u00([0-9A-Fa-f]{2})|([0-7]{1,3})|(.))", re.DOTALL)


def find_bytes(line: bytes, shape: bytes, skip_to: int = 0) -> list[FoundBytes]:
    """Return the places of a line at which bytes are written, in their order.

    `shape` is the shape of `line`; nothing is looked for before `skip_to`, where its time ends.
    Places overlap if bytes can be read in two ways.
    """
    offset = _OFFSET.match(shape, skip_to)
    if offset is not None:
        row = _row(shape, offset.end())
        if row is not None:
            return [row]
    places = [one for each in NOTATIONS for one in _find_notation(each, shape, skip_to)]
    if all(_size(shape, one) < MIN_PURE for one in places):
        places += _find_notation(_GROUPS, shape, skip_to)
    places.sort(key=lambda one: one.start - one.end)
    chosen: list[FoundBytes] = []
    starts: list[int] = []
    for one in places:
        at = bisect_left(starts, one.end)
        if at == 0 or chosen[at - 1].end <= one.start:
            chosen.insert(at, one)
            starts.insert(at, one.start)
    if not chosen:
        single = _SINGLE.search(shape, skip_to)
        if single is not None:
            chosen.append(FoundBytes(*single.span(1), _digits))
    if b"\\" in line or b'(0, "' in shape:
        chosen += _quoted(line, skip_to)
    chosen += _find_notation(_DECIMALS, shape, skip_to) + _find_notation(
        _BARE_DECIMALS, shape, skip_to
    )
    return sorted(chosen, key=lambda one: one.start)


def _find_notation(notation: Notation, shape: bytes, skip_to: int) -> list[FoundBytes]:
    if not any(hint in shape for hint in notation.hints):
        return []
    return [
        FoundBytes(*one.span(), notation.read) for one in notation.pattern.finditer(shape, skip_to)
    ]


def _size(shape: bytes, one: FoundBytes) -> int:
    return shape.count(b"00", one.start, one.end)


_ROW = re.compile(rb"00(?: {0,2}00){0,%d}(?![0-9A-Za-z])" % (DUMP_ROW - 1))


def _row(shape: bytes, start: int) -> FoundBytes | None:
    """The bytes of a row of a dump, which begin at `start`; None if there are none."""
    match = _ROW.match(shape, start)
    return None if match is None else FoundBytes(*match.span(), _digits, is_row=True)


def _quoted(line: bytes, skip_to: int) -> Iterator[FoundBytes]:
    for match in _QUOTED.finditer(line, skip_to):
        which = 1 if match[1] is not None else 2
        if _CODED.search(match[which]) or _CALL.search(line, 0, match.start()):
            yield FoundBytes(*match.span(which), unescaped)


def unescaped(text: bytes) -> bytes:
    r"""Read a text with escapes as C, Python and JSON write them: \\x01, \\1, \\u0001, \\n."""
    return _ESCAPE.sub(_unescape, text)


def _unescape(match: re.Match[bytes]) -> bytes:
    digits = match[1] or match[2]
    if digits:
        return bytes.fromhex(digits.decode())
    if match[3]:
        return bytes((int(match[3], 8) & 0xFF,))
    return _LETTERS.get(match[4], match[4])


READ_BYTES = 1 << 16
MAX_LINE = 1 << 16
"""A longer line is read in pieces of this many bytes."""
MAX_SHAPES = 4096
LOOK_BACK = 4
"""The number of lines before a line in which its mark or time is looked for."""
MAX_BACK_NS = 2_000_000_000
MAX_UNTIMED = 256
LEAST_BYTES = 4
"""Fewer bytes than these at one place, without a mark, are no part of a frame."""
MASTER = "master"
"""The name of the master of a connection in a log, which seldom tells its address."""

MAY_BE_BYTES = re.compile(
    rb"00[ ,:|;\t_-]{1,2}00(?![0-9A-Za-z])|0[xX]0|0{8}|[\[<]00[\]>]|\\[x0]|00[hH][ ,]"
    rb"|0{2,}0(?: 0000)|\(0+, \"|[ 0]000#00|0{4} \| 00|00\.00\.00\.00|(?:0{1,3}(?:,\s?|-)){3}"
    rb"|(?:[:=>\]]\s{0,2}|^\s*)00(?:\s{3,}\S{1,3})?\s*$"
)
_DATED = re.compile(rb"\[?\d{4}[-/.]\d\d[-/.]\d\d[ T_,]\d\d:\d\d:\d\d(?:[.,:]\d{1,9})?")
"""A time at the front of a line, which is not searched for bytes."""
_SEPARATORS = bytes.maketrans(b",:|;\t_-.\r\f\vXH<", b" " * 11 + b"xh[")
_HINTS = (b"00 00", b"0x0", b"00000000", b"00  00", b"[00", b"\\", b"00h", b"00   00", b'0  "',
          b"0#00")  # fmt: skip
"""Texts of which a line with bytes has at least one, after _SEPARATORS has translated it, unless it
ends with a byte or has several commas or dashes. They are found faster than MAY_BE_BYTES."""
_BEFORE_LAST = b":=>]"
"""The signs, besides the front of the line, behind which a single byte at the end of a line may
stand."""
_UNIMPORTANT = re.compile(rb"[0\s]+")
_COLOURS = re.compile(rb"\x1b\[[0-9;]*[A-Za-z]")
_ESC = b"\x1b"


class _BytesPlace(NamedTuple):
    """A place of a line at which bytes are written, with what stands before it."""

    readings: tuple[FoundBytes, ...]
    label: Label


class _Plan(NamedTuple):
    """What to read in lines of one shape."""

    time: Time | None
    places: tuple[_BytesPlace, ...]


_NO_PLAN_YET = _Plan(None, ())
"""Stands for the plan of a shape that did not come before. None is the plan of a shape that cannot
have bytes."""


class _LineFacts(NamedTuple):
    """The facts that lines of one shape tell about the bytes in later lines."""

    has_bytes: bool
    """True if the lines have bytes enough for a frame, so that a mark in them tells about these
    bytes and not about later ones."""
    mark: Mark | None
    time: Time | None


class TextLog:
    """Reads the frames of one text file."""

    def __init__(self, stream: BinaryIO, name: str, link: str, line: SerialFormat) -> None:
        self._stream = stream
        self._link = link
        self._character_ns = line.character_ns
        self._origin = Origin(name, 0)
        self._connection = Connection(Endpoint(MASTER, 0), Endpoint(link, MODBUS_PORT))
        self._frames = TextFrames()
        self._plans: dict[bytes, _Plan | None] = {}
        self._line_facts: dict[bytes, _LineFacts] = {}
        """The facts that lines of each shape tell about later lines, by the shape."""
        self._recent: deque[tuple[bytes, bytes]] = deque(maxlen=LOOK_BACK)
        """The last lines, and their shapes."""
        self._last_row: tuple[int, Label] | None = None
        """The number and the label of the last row of a dump."""
        self._last_mark: tuple[int, Mark | None] = 0, None
        """The number and the mark of the last line that had bytes."""
        self._dates = DateOrder()
        self._day_ns = 0
        self._clock_ns = 0
        self._time_ns: int | None = None
        """The last time that a line of bytes had."""
        self._sent_ns = 0
        self._is_timed = False
        self._bytes = 0
        self.lines = 0
        self.bytes_seen = 0
        """The number of bytes that the log shows, of frames or not."""
        self.found = 0
        """The number of frames found."""
        self.steps_back = 0
        """How often the time of a frame is MAX_BACK_NS or more before that of the frame before."""
        self.first_step_back = 0
        """The number of the line at which that happens first; 0 if it does not."""

    @property
    def guessed_date(self) -> str:
        """A date whose day and month were guessed, as nothing in the log shows their order; empty
        if there is none.
        """
        return self._dates.guessed.decode() if self._dates.is_guessed else ""

    @property
    def shown_twice(self) -> int:
        """The number of frames that the log shows twice, and which count once."""
        return self._frames.left_out

    @property
    def bare(self) -> int:
        """The number of frames that the log shows without their CRC, which was computed."""
        return self._frames.bare

    def pieces(self) -> Iterator[Chunk | WireEvent | StreamGap]:
        """Yield the frames of the log, each as a chunk; none if it is not known to be Modbus.

        Where the log lacks a part of a response, the loss is yielded.
        """
        frames = self._found_frames()
        first: list[TextFrame] = []
        for frame in frames:
            first.append(frame)
            if frame.ts_ns is not None:
                self._is_timed, self._sent_ns = True, frame.ts_ns
                break
            if len(first) == MAX_UNTIMED:
                break
        for frame in chain(first, frames):
            yield self._chunk(frame) if frame.is_whole else self._loss(frame)

    def _found_frames(self) -> Iterator[TextFrame]:
        for lines in self._blocks():
            shapes = b"\n".join(lines).translate(SHAPE).split(b"\n")
            for line, shape in zip(lines, shapes, strict=True):
                self.lines += 1
                plan = self._plans.get(shape, _NO_PLAN_YET)
                if plan is _NO_PLAN_YET:
                    plan = self._make_plan(line, shape) if may_be_bytes(line, shape) else None
                if plan is not None:
                    yield from self._read(line, plan)
                self._recent.append((line, shape))
        yield from self._frames.close()

    def _blocks(self) -> Iterator[list[bytes]]:
        """Yield the lines of the file, many at a time, without their ends and without colours."""
        read = cast("io.BufferedIOBase", self._stream).read1
        decoder: codecs.IncrementalDecoder | None = None
        rest = b""
        is_first = True
        while data := read(READ_BYTES):
            if is_first and data.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
                decoder = codecs.getincrementaldecoder("utf-16")("replace")
            if decoder is not None:
                data = decoder.decode(data).encode("utf-8", "replace")
            if b"\0" in data:
                data = data.replace(b"\0", b"")  # A machine that lost its power leaves them.
            if is_first:
                self._dates.note(data)
            is_first = False
            lines = (rest + data).split(b"\n")
            rest = lines.pop()
            if len(rest) >= MAX_LINE:
                lines.append(rest)
                rest = b""
            if lines:
                yield _without_colours(lines)
        if rest:
            yield _without_colours([rest])

    def _make_plan(self, line: bytes, shape: bytes) -> _Plan | None:
        """Find what to read in lines of this shape; None if there is nothing."""
        if len(self._plans) >= MAX_SHAPES:
            self._plans.clear()
        plan = self._plans[shape] = _plan(line, shape)
        return plan

    def _read(self, line: bytes, plan: _Plan) -> list[TextFrame]:
        ts_ns = None if plan.time is None else self._read_time_ns(plan.time, line)
        frames: list[TextFrame] = []
        for place in plan.places:
            choices = []
            for each in place.readings:
                try:
                    choices.append(each.read(line[each.start : each.end]))
                except ValueError:
                    continue
            if not choices:
                continue
            self.bytes_seen += len(choices[0])
            first, label = place.readings[0], place.label
            if first.is_row or not (label.text or label.mark or plan.time):
                label, ts_ns = self._label_and_time_of_dump_row(line[: first.start], label, ts_ns)
            elif label.mark is None or ts_ns is None:
                label, ts_ns = self._label_and_time_of_lines_before(label, ts_ns)
            is_short = len(choices[0]) < LEAST_BYTES and not first.is_row
            if is_short and label.mark is None and not self._frames.is_open(label, self.lines):
                continue
            self._last_mark = self.lines, label.mark
            self._time_ns = ts_ns if ts_ns is not None else self._time_ns
            frames += self._frames.feed(choices, label, self._time_ns, self.lines)
        return frames

    def _label_and_time_of_dump_row(
        self, offset: bytes, label: Label, ts_ns: int | None
    ) -> tuple[Label, int | None]:
        """Return the label and the time of a row of bytes: those of its heading.

        `offset` is the offset at the front of the row; it is 0 where a dump begins.
        """
        is_first = b"0" in offset and not offset.strip(b" \t:|0xh")
        if is_first:
            self._frames.drop_parts()
        if not is_first and self._last_row is not None and self._last_row[0] == self.lines - 1:
            label = self._last_row[1]
        elif label.mark is None:
            label, ts_ns = self._label_and_time_of_lines_before(label, ts_ns)
        self._last_row = self.lines, label
        return label, ts_ns

    def _label_and_time_of_lines_before(
        self, label: Label, ts_ns: int | None
    ) -> tuple[Label, int | None]:
        """Return the label and the time, each from the lines before if the line has none."""
        mark: Mark | None = label.mark
        row = self.lines
        for line, shape in reversed(self._recent):
            row -= 1
            facts = self._line_facts.get(shape)
            if facts is None:
                if len(self._line_facts) >= MAX_SHAPES:
                    self._line_facts.clear()
                facts = self._line_facts[shape] = _facts_for_later_lines(
                    line, self._plans.get(shape)
                )
            is_of_bytes = facts.has_bytes
            mark = mark or facts.mark
            if ts_ns is None and facts.time is not None:
                ts_ns = self._read_time_ns(facts.time, line)
            if is_of_bytes and mark is None and self._last_mark[0] == row and line[:1].isspace():
                mark = self._last_mark[1]  # Both lines belong to one object.
            if (mark is not None and ts_ns is not None) or is_of_bytes:
                break
        if mark is not None and label.mark is None:
            label = Label(label.text + b"/" + mark.word, mark)
        return label, ts_ns

    def _read_time_ns(self, time: Time, line: bytes) -> int | None:
        try:
            ts_ns = self._dates.read(time, line[time.start : time.end])
        except (ValueError, KeyError):
            return None
        if time.is_clock:
            if self._day_ns and ts_ns - self._clock_ns > DAY_NS - MAX_BACK_NS:
                return ts_ns + self._day_ns - DAY_NS  # A line of the day before came late.
            if ts_ns < self._clock_ns - DAY_NS // 2:
                self._day_ns += DAY_NS
            self._clock_ns = ts_ns
            ts_ns += self._day_ns
        return ts_ns if 0 <= ts_ns < MAX_TIME_NS else None

    def _loss(self, frame: TextFrame) -> WireEvent | StreamGap:
        """The event for a response of which the log lacks a part."""
        ts_ns = self._sending_ns(frame)
        if frame.transport is Transport.TCP:
            return StreamGap(ts_ns, self._connection, Direction.RESPONSE, 0)
        what = f"line {frame.row}: the response is not whole in this text: {frame.raw.hex(' ')}"
        return WireEvent(ts_ns=ts_ns, link=self._link, kind=EventKind.GAP, message=what)

    def _sending_ns(self, frame: TextFrame) -> int:
        """The time of a frame, which is that of the frame before if it has none or is a little
        earlier.
        """
        self._bytes += len(frame.raw)
        ts_ns = frame.ts_ns
        if not self._is_timed:
            ts_ns = self._bytes * self._character_ns
        elif ts_ns is None or 0 < self._sent_ns - ts_ns < MAX_BACK_NS:
            ts_ns = self._sent_ns
        elif ts_ns < self._sent_ns:
            self.steps_back += 1
            self.first_step_back = self.first_step_back or frame.row
        self._sent_ns = ts_ns
        return ts_ns

    def _chunk(self, frame: TextFrame) -> Chunk:
        ts_ns = self._sending_ns(frame)
        self.found += 1
        is_network = frame.transport is Transport.TCP
        origin = None if is_network else StreamPlace(0, None, self._origin)
        return Chunk(
            ts_ns=ts_ns,
            link=self._link,
            data=frame.raw,
            direction=frame.direction,
            stamp=Stamp.AT_ONCE if self._is_timed else Stamp.UNKNOWN,
            connection=self._connection if is_network else None,
            place=origin,
        )


def _facts_for_later_lines(line: bytes, plan: _Plan | None) -> _LineFacts:
    has_bytes = plan is not None and any(
        one.end - one.start >= 2 * LEAST_BYTES for place in plan.places for one in place.readings
    )
    mark = None if has_bytes else find_mark(line, is_strong=True)
    return _LineFacts(has_bytes, mark, find_time(line))


def _without_colours(lines: list[bytes]) -> list[bytes]:
    return [
        _COLOURS.sub(b"", line.rstrip(b"\r")) if _ESC in line else line.rstrip(b"\r")
        for line in lines
    ]


def may_be_bytes(line: bytes, shape: bytes) -> bool:
    """True if bytes may be written behind the time at the front of a line."""
    front = _DATED.match(line)
    start = 0 if front is None else front.end()
    rest = shape[start:]
    spaced = rest.translate(_SEPARATORS)
    for hint in _HINTS:
        if hint in spaced:
            break
    else:
        if rest.count(b",") + rest.count(b"-") < 3 and b"00   " not in spaced:
            *before, last = (b"", *rest.rsplit(None, 1))
            if last[-2:] != b"00" or (last[:-2] or before[-1])[-1:] not in _BEFORE_LAST:
                return False
    return MAY_BE_BYTES.search(shape, start) is not None


def _plan(line: bytes, shape: bytes) -> _Plan | None:
    time = find_time(line)
    found = find_bytes(line, shape, 0 if time is None else time.end)
    if time is not None and not found:
        found = find_bytes(line, shape)
        if time.is_number and found and found[0].start <= time.start:
            time = None  # The first bytes of a frame are no time.
        else:
            found = [one for one in found if one.end <= time.start]
    places: list[_BytesPlace] = []
    end = 0
    for one in found:
        if places and one.start < end:
            last = places[-1]
            places[-1] = last._replace(readings=(*last.readings, one))
            end = max(end, one.end)
            continue
        before = line[end : one.start]
        mark = find_mark(before) or (places[-1].label.mark if places else None)
        mark = mark or find_mark(line[one.end :], last=False) or bracket_mark(shape[one.start :])
        text = _UNIMPORTANT.sub(b"", shape[end : one.start])[-80:]
        places.append(_BytesPlace((one,), Label(text, mark)))
        end = one.end
    return _Plan(time, tuple(places)) if places else None
