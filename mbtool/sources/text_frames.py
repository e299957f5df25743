"""Finds whole Modbus frames among the bytes that a log shows, and decides who sent each."""

# Bytes are a frame if the CRC is correct at the length that the function of an RTU frame gives, if
# the LRC of an ASCII frame is correct, or if the length in an MBAP header fits the function. Other
# bytes may be a part of a frame. They are kept together with earlier bytes of the same label (the
# text before the bytes in the line, such as `recv:`), and joined with later bytes of this label.
# RTU frames are searched anywhere in joined bytes. Other frames are only searched where a piece
# begins, since zeros look like an MBAP header.
#
# The direction of a frame comes from the first of these that decides:
#
#     1  the form of the frame, if only a request or only a response has it
#     2  the label, if its other frames have shown a direction
#     3  the word of the label (`Tx`), if other frames with this word have shown a direction
#     4  the last request: the frame is a response if it answers that request
#     5  the meaning of the word; a frame without a word is a request
#
# Many programs show a frame twice, and an adapter may hear the bytes that it sends. So a frame is
# left out if the previous frame is equal, in the same direction, and has another label; an equal
# request with the same label is a retry. If a log shows an ADU of Modbus/TCP also as an RTU frame,
# all its RTU frames are left out.
#
# Some programs show unit and PDU without a frame. In a log without frames, such bytes count as RTU
# frames with the CRC that they would have: a request in the form of its function, and the response
# to it directly after it, both with a word or arrow.
#
# A log may show a damaged response. If the bytes after a request have the length of its response,
# and a word or arrow, they are this response with a wrong CRC. If they only begin like the response
# and the next frame is another request, the log lacks the rest. Then a frame with `is_whole` False
# is returned, since the slave was not silent.
#
# A log counts as Modbus once it has given enough evidence (ENOUGH_EVIDENCE). Earlier frames are
# held until then.
#
# Memory: MAX_HELD frames, and MAX_LABELS labels with at most MAX_PART bytes each.

from __future__ import annotations

import re
from collections import OrderedDict, defaultdict, deque
from functools import lru_cache
from typing import TYPE_CHECKING, NamedTuple

from mbtool.core import Direction
from mbtool.core.limits import LAST_UNIT
from mbtool.framing.rtu_lengths import MIN_FRAME, frame_size
from mbtool.modbus.adu import (
    MAX_RTU_ADU,
    MAX_TCP_ADU,
    MBAP_BYTES,
    Transport,
    crc,
    mbap_size,
    read_frame,
)
from mbtool.modbus.expected_response import ExpectedResponse
from mbtool.modbus.functions import EXCEPTION_BIT, FUNCTIONS
from mbtool.modbus.pdu import parse_pdu, pdu_length, pdu_of

if TYPE_CHECKING:
    from mbtool.sources.text_marks import Mark

MAX_HELD = 256
MAX_LABELS = 256
MAX_PART = 2 * MAX_RTU_ADU
MAX_BEGINS = 8
"""A frame other than RTU is looked for at the beginnings of at most this many of the last pieces of
bytes, and of the first piece since the last frame."""
MAX_LINES_APART = 64
"""Bytes are joined with those before them if at most this many lines lie between."""
ENOUGH_EVIDENCE = 4
"""The evidence from which on a log is taken for Modbus. A request with its response right behind it
is enough; an RTU frame counts 2 if a word or arrow gives it a direction, otherwise 1; a frame of
another kind counts 1 if it has a direction, and 1 if its transaction id is the next one. A frame
must have the form of its function. One of 65,536 random runs of bytes has a right CRC, and few of
these have the length of a function."""
MAX_MISSES = 32
"""After this many runs of bytes without a frame, the evidence so far counts no more. The rows of a
dump of one frame are 17 at most."""

FEW_MISSES = 16
"""At its end, a log with too little evidence is still taken for Modbus if at most this many runs of
bytes were no frame, and a word or arrow gave an RTU frame its direction."""
FEWEST_MISSES = 4
"""The limit in place of FEW_MISSES if no RTU frame has a direction by a word or arrow, but there is
an RTU frame of 8 bytes, as most requests are, or of 5, as exception responses are, or at least two
different RTU frames."""

_MARKED = 2
_USUAL_SIZES = (5, 8)
_MIN_MBAP, _MIN_BARE = MBAP_BYTES + 1, 3
_SENDERS = (Direction.REQUEST, Direction.RESPONSE)
_CODES = bytes(sorted({*FUNCTIONS, *(code | EXCEPTION_BIT for code in FUNCTIONS)}))
_RTU_START = re.compile(rb"(?=[\x00-\xf7][%s])" % re.escape(_CODES), re.DOTALL)
_ASCII = re.compile(rb":(?:[0-9A-Fa-f]{2}){4,255}\r?\n?")


class TextFrame(NamedTuple):
    """A whole ADU from a log."""

    ts_ns: int | None
    """The time that the log gives; None if it gives none."""
    raw: bytes
    transport: Transport
    direction: Direction
    row: int
    """The number, from 1, of the frame's line in the file."""
    is_whole: bool = True
    """False for bytes that only begin like a response; the log lacks the rest."""


class Label(NamedTuple):
    """Where bytes stand in the lines of a log: the text before them, and its mark."""

    text: bytes
    mark: Mark | None


class _FoundFrame(NamedTuple):
    """A frame in the text, before its direction is decided."""

    transport: Transport
    raw: bytes
    ts_ns: int | None
    row: int
    direction: Direction | None = None
    """The direction if it is known beforehand."""


class _OpenBytes:
    """Bytes of one label that are no whole frame yet, at most MAX_PART."""

    def __init__(self) -> None:
        self.data = b""
        self.row = 0
        """The number of the last line that brought bytes."""
        self.misses = 0
        """The number of pieces so far that completed no frame."""
        self._begins: list[int] = []
        """The offsets at which the last pieces begin, at which a frame of any kind may begin."""
        self._open: list[tuple[int, int]] = []
        """The places, begin and end, at which an RTU frame may stand that is not complete."""
        self._searched = 0
        """The offset up to which beginnings of RTU frames were looked for."""

    def feed(self, data: bytes) -> list[tuple[Transport, bytes]]:
        """Take more bytes; return the frames that they complete, and forget all before these."""
        size = len(self.data)
        self.data += data
        for begin in self._begins:
            if len(self.data) - begin <= MAX_TCP_ADU and (whole := whole_frames(self.data[begin:])):
                self._drop(len(self.data))
                return [*whole]
        self._begins = [*self._begins[:1], *self._begins[1:][1 - MAX_BEGINS :], size]
        self._search()
        found = self._complete()
        if not found and b":" in self.data:
            found = self._ascii()
        if len(self.data) > MAX_PART:
            self._drop(len(self.data) - MAX_PART)
        return found

    def _search(self) -> None:
        """Look for places at which an RTU frame may begin, once for each byte."""
        for match in _RTU_START.finditer(self.data, self._searched):
            at = match.start()
            start = self.data[at : at + MAX_RTU_ADU]
            sizes = [frame_size(start, direction) for direction in _SENDERS]
            if None in sizes:
                self._searched = at
                return
            self._open += [(at, at + size) for size in {*sizes} if size]
        self._searched = max(self._searched, len(self.data) - 1)

    def _complete(self) -> list[tuple[Transport, bytes]]:
        """Return the whole RTU frames, and forget all up to the last one, and the complete places
        that hold none.
        """
        found: list[tuple[Transport, bytes]] = []
        still_open, done, size = [], 0, len(self.data)
        for begin, end in self._open:
            if begin < done:
                continue
            if end > size:
                still_open.append((begin, end))
            elif crc(self.data[begin:end]) == 0:
                found.append((Transport.RTU, self.data[begin:end]))
                done = end
        self._open = still_open
        self._drop(done)
        return found

    def _ascii(self) -> list[tuple[Transport, bytes]]:
        found = []
        end = 0
        for match in _ASCII.finditer(self.data):
            if match[0].endswith((b"\r", b"\n")):
                found += _ascii_frames(match[0])
                end = match.end()
        self._drop(end)
        return found

    def _drop(self, count: int) -> None:
        self.data = self.data[count:]
        self._open = [(begin - count, end - count) for begin, end in self._open if begin >= count]
        self._begins = [begin - count for begin in self._begins if begin >= count]
        self._searched = max(0, self._searched - count)


class TextFrames:
    """Takes the bytes of one line after the other; returns frames."""

    def __init__(self) -> None:
        self._parts: OrderedDict[bytes, _OpenBytes] = OrderedDict()
        self._labels: dict[bytes, list[int]] = {}
        self._words: defaultdict[bytes, list[int]] = defaultdict(lambda: [0, 0])
        self._last: tuple[TextFrame, bytes] | None = None
        """The last frame, and the text of its label."""
        self._pending: TextFrame | None = None
        self._held: deque[TextFrame] = deque(maxlen=MAX_HELD)
        self._is_network = False
        """True once a Modbus/TCP ADU was shown as an RTU frame, too."""
        self.is_modbus = False
        """True once the log has shown that it has Modbus frames."""
        self._evidence = 0
        self._misses = 0
        self._has_marked = False
        """True once an RTU frame had a direction by a word or arrow."""
        self._missed = 0
        """The number of places with bytes but no frame, counted until the log is known to have
        Modbus frames."""
        self._bare_request: _FoundFrame | None = None
        """The last request that was shown without a frame, with the CRC that it would have."""
        self._begun: TextFrame | None = None
        """The bytes that began like the response to the last request, if the response did not
        follow."""
        self.bare = 0
        """The number of frames that were shown without their CRC."""
        self.left_out = 0
        """The number of frames that were shown twice."""

    def feed(
        self, choices: list[bytes], label: Label, ts_ns: int | None, row: int
    ) -> list[TextFrame]:
        """Take the bytes at one place of a line, and other readings of the same place.

        Returns the frames that are complete, if the log is known to be Modbus.
        """
        for data in choices:
            found = [*whole_frames(data, marked=label.mark is not None)]
            if found:
                self._parts.pop(label.text, None)
                break
        else:
            found = self._join_pieces(choices[0], label, row)
        shown = [_FoundFrame(transport, raw, ts_ns, row) for transport, raw in found] or self._bare(
            choices[0], label, ts_ns, row
        )
        if not self.is_modbus:
            self._note_miss(choices[0], is_miss=not shown)
        if not shown and self._pending is not None:
            shown = self._damaged_response(choices[0], self._pending, label, ts_ns, row)
        frames = [frame for one in shown for frame in self._frame(one, label)]
        if self.is_modbus:
            if self._held:
                frames = [*self._held, *frames]
                self._held.clear()
            return frames
        return []

    def close(self) -> list[TextFrame]:
        """Return the frames of a log that ends before it has given enough evidence.

        There are some only if nearly all bytes of the log were frames.
        """
        rtu = {one.raw for one in self._held if one.transport is Transport.RTU}
        has_rtu = len(rtu) > 1 or any(len(one) in _USUAL_SIZES for one in rtu)
        most = FEW_MISSES if self._has_marked else FEWEST_MISSES if has_rtu else 0
        if self.is_modbus or self._missed > most or not self._evidence:
            return []
        return [*self._held]

    def drop_parts(self) -> None:
        """Forget incomplete bytes, as at the beginning of another dump."""
        self._parts.clear()

    def is_open(self, label: Label, row: int) -> bool:
        """True if bytes at the same place of a line shortly before are no whole frame yet."""
        part = self._parts.get(label.text)
        return part is not None and bool(label.text) and row - part.row <= MAX_LINES_APART

    def _damaged_response(
        self, data: bytes, asked: TextFrame, label: Label, ts_ns: int | None, row: int
    ) -> list[_FoundFrame]:
        """Return the response to the last request if it has its length, but a wrong CRC.

        If the bytes only begin like the response, note that.
        """
        is_begin = _begins_answer(data, asked)
        if is_begin and asked.raw.startswith(data):
            # The bytes equal the beginning of the request, so they may be the request shown again.
            # They are a response only if their label has a mark and differs from the label before.
            before = None if self._last is None else self._last[1]
            is_begin = label.mark is not None and label.text != before
        if is_begin and asked.transport is Transport.RTU and label.mark is not None:
            size = frame_size(data, Direction.RESPONSE)
            if size == len(data) and crc(data) and _answers(asked.raw, Transport.RTU, data):
                self._parts.pop(label.text, None)
                return [_FoundFrame(Transport.RTU, data, ts_ns, row, Direction.RESPONSE)]
        if is_begin and self._begun is None:
            way = Direction.RESPONSE
            self._begun = TextFrame(ts_ns, data, asked.transport, way, row, is_whole=False)
        return []

    def _bare(self, data: bytes, label: Label, ts_ns: int | None, row: int) -> list[_FoundFrame]:
        """Return a request and its response that are shown without a frame, once both are there."""
        is_framed = self._last is not None and not self.bare
        if is_framed or label.mark is None or not _MIN_BARE <= len(data) <= MAX_RTU_ADU - 2:
            return []
        raw = data + crc(data).to_bytes(2, "little")
        form = forms(Transport.RTU, raw) if data[1] & ~EXCEPTION_BIT in FUNCTIONS else ()
        asked, self._bare_request = self._bare_request, None
        is_answer = asked is not None and Direction.RESPONSE in form
        if asked is not None and is_answer and _answers(asked.raw, Transport.RTU, raw):
            self.bare += 2
            return [asked, _FoundFrame(Transport.RTU, raw, ts_ns, row, Direction.RESPONSE)]
        if Direction.REQUEST in form and data[0] <= LAST_UNIT:
            self._bare_request = _FoundFrame(Transport.RTU, raw, ts_ns, row, Direction.REQUEST)
        return []

    def _note_miss(self, data: bytes, *, is_miss: bool) -> None:
        if is_miss and self._last is not None and data in self._last[0].raw:
            return  # The program shows a part of the frame again.
        self._misses = self._misses + (len(data) >= MIN_FRAME) if is_miss else 0
        self._missed += is_miss
        if self._misses >= MAX_MISSES:
            self._evidence = 0
            self._held.clear()

    def _join_pieces(self, data: bytes, label: Label, row: int) -> list[tuple[Transport, bytes]]:
        part = self._parts.pop(label.text, None)
        if part is None or row - part.row > MAX_LINES_APART:
            part = _OpenBytes()
        part.row = row
        found = part.feed(data)
        if found:
            self._missed -= part.misses  # They were parts of a frame.
            part.misses = 0
        elif not self.is_modbus:
            part.misses += 1
        if part.data:
            self._parts[label.text] = part
            if len(self._parts) > MAX_LABELS:
                self._parts.popitem(last=False)
        return found

    def _frame(self, one: _FoundFrame, label: Label) -> list[TextFrame]:
        """Decide the direction of a frame, if it is not known; return it if it was not shown before
        and the log is known, behind the part of a response that precedes it.
        """
        transport, raw, ts_ns, row, way = one
        if self._is_network and transport is not Transport.TCP:
            self.left_out += 1
            return []
        form = forms(transport, raw)
        direction, is_sure = way, False
        if direction is None:
            direction, is_sure = self._direction(transport, raw, form, label)
        frame = TextFrame(ts_ns, raw, transport, direction, row)
        if is_sure:
            self._learn(label, direction)
        if self._is_other_form(frame):
            self._keep_network()
            if transport is not Transport.TCP:
                self.left_out += 1
                return []
        elif self._is_shown_twice(frame, label, is_sure=is_sure):
            self.left_out += 1
            return []
        begun, self._begun = self._begun, None
        if direction is Direction.RESPONSE or self._pending is None:
            begun = None
        before, self._last = self._last, (frame, label.text)
        asked, self._pending = self._pending, frame if direction is Direction.REQUEST else None
        if not self.is_modbus:
            is_pair = (
                asked is not None
                and direction is Direction.RESPONSE
                and asked.transport is transport
                and _answers(asked.raw, transport, raw)
            )
            is_marked = label.mark is not None and label.mark.is_strong
            is_next = before is not None and _follows(before[0], frame)
            weight = _weight(transport, form, is_marked) + is_next
            self._has_marked |= weight >= _MARKED
            is_echo = before is not None and (before[0].raw, before[1]) == (raw, label.text)
            self._evidence += ENOUGH_EVIDENCE if is_pair and form and not is_echo else weight
            self.is_modbus = self._evidence >= ENOUGH_EVIDENCE
            if not self.is_modbus:
                self._held += [frame] if begun is None else [begun, frame]
                return []
        return [frame] if begun is None else [begun, frame]

    def _direction(
        self, transport: Transport, raw: bytes, form: tuple[Direction, ...], label: Label
    ) -> tuple[Direction, bool]:
        """Return the direction of a frame, and True if its form alone shows it."""
        if len(form) == 1:
            return form[0], True
        of_label = _majority_direction(self._labels.get(label.text))
        if of_label is not None:
            return of_label, False
        of_word = (
            _majority_direction(self._words[label.mark.word]) if label.mark is not None else None
        )
        if of_word is not None:
            return of_word, False
        asked = self._pending
        is_same = asked is not None and asked.transport is transport
        if asked is not None and is_same and _answers(asked.raw, transport, raw):
            return Direction.RESPONSE, False
        if label.mark is None:
            return Direction.REQUEST, False
        return (Direction.REQUEST if label.mark.is_sent else Direction.RESPONSE), False

    def _learn(self, label: Label, direction: Direction) -> None:
        which = direction is Direction.RESPONSE
        if len(self._labels) >= MAX_LABELS and label.text not in self._labels:
            self._labels.clear()
        self._labels.setdefault(label.text, [0, 0])[which] += 1
        if label.mark is not None:
            if len(self._words) >= MAX_LABELS and label.mark.word not in self._words:
                self._words.clear()
            self._words[label.mark.word][which] += 1

    def _is_other_form(self, frame: TextFrame) -> bool:
        """True if a frame is the one before in another form: of a Modbus/TCP ADU some programs show
        the RTU frame, too.
        """
        if self._last is None or self._last[0].transport is frame.transport:
            return False
        last = self._last[0]
        return pdu_of(last.transport, last.raw) == pdu_of(frame.transport, frame.raw)

    def _keep_network(self) -> None:
        """From now on, leave out the frames that are not of Modbus/TCP; forget those held."""
        self._is_network = True
        kept = [one for one in self._held if one.transport is Transport.TCP]
        self.left_out += len(self._held) - len(kept)
        self._held = deque(kept, MAX_HELD)
        self._pending = None

    def _is_shown_twice(self, frame: TextFrame, label: Label, *, is_sure: bool) -> bool:
        if self._last is None:
            return False
        last, text = self._last
        if last.raw != frame.raw or (last.direction is not frame.direction and label.mark):
            return False
        return text != label.text and (
            is_sure or label.mark is None or last.direction is frame.direction
        )


def _weight(transport: Transport, form: tuple[Direction, ...], is_marked: bool) -> int:
    if not form:
        return 0
    return is_marked + (transport is Transport.RTU)


def _follows(before: TextFrame, frame: TextFrame) -> bool:
    """True if two Modbus/TCP ADUs have transaction ids in a row."""
    if before.transport is not Transport.TCP or frame.transport is not Transport.TCP:
        return False
    ids = [int.from_bytes(one.raw[:2]) for one in (before, frame)]
    return ids[1] == ids[0] + 1


def _majority_direction(votes: list[int] | None) -> Direction | None:
    """Return the direction that has at least three of four votes; None if neither has."""
    if votes is None or 4 * max(votes) < 3 * sum(votes) or not sum(votes):
        return None
    return _SENDERS[votes[1] > votes[0]]


def _answers(request: bytes, transport: Transport, raw: bytes) -> bool:
    """True if the frame `raw` can be the response to a request of the same transport."""
    if transport is Transport.TCP and request[:2] != raw[:2]:
        return False
    unit, asked = pdu_of(transport, request)
    other, pdu = pdu_of(transport, raw)
    expected = ExpectedResponse.of(asked)
    return unit == other and expected is not None and expected.fits(pdu)


def _begins_answer(data: bytes, asked: TextFrame) -> bool:
    """True if bytes begin like the response to a request."""
    match asked.transport:
        case Transport.RTU:
            start = data[:2]
            return start in (asked.raw[:2], bytes((asked.raw[0], asked.raw[1] | EXCEPTION_BIT)))
        case Transport.ASCII:
            return data[:3] == asked.raw[:3]
        case _:
            return data[:4] == asked.raw[:4] and len(data) > 4


@lru_cache(maxsize=1024)
def forms(transport: Transport, raw: bytes) -> tuple[Direction, ...]:
    """The directions of which an ADU has the form."""
    _, pdu = pdu_of(transport, raw)
    found = tuple(each for each in _SENDERS if pdu_length(pdu, each) in (len(pdu), 0))
    if pdu[0] & EXCEPTION_BIT:
        return (Direction.RESPONSE,) if Direction.RESPONSE in found else ()
    if len(found) == 1 and pdu[0] in FUNCTIONS:
        return found
    return tuple(each for each in _SENDERS if parse_pdu(pdu, each).problem is None)


@lru_cache(maxsize=1024)
def whole_frames(data: bytes, *, marked: bool = False) -> tuple[tuple[Transport, bytes], ...]:
    """Return the frames of which bytes consist, without a rest; an empty tuple if they do not.

    `marked` is True if a word says that the bytes were sent or received. Then one RTU frame
    counts that has not the length of its function, or a function that no table knows.
    """
    if data[:1] == b":":
        return tuple(_ascii_frames(data))
    return tuple(_rtu_frames(data, marked=marked) or _mbap_frames(data))


def _rtu_frames(data: bytes, *, marked: bool) -> list[tuple[Transport, bytes]]:
    found = []
    at = 0
    while at < len(data):
        size = _rtu_size(data, at)
        if not size:
            break
        found.append((Transport.RTU, data[at : at + size]))
        at += size
    if at == len(data):
        return found
    is_frame = marked and MIN_FRAME <= len(data) <= MAX_RTU_ADU and crc(data) == 0
    return [(Transport.RTU, data)] if is_frame and data[1] > 0 else []


def _rtu_size(data: bytes, at: int) -> int:
    """The size of the RTU frame of a known function that begins at `at`; 0 if there is none."""
    start = data[at : at + MAX_RTU_ADU]
    if len(start) < MIN_FRAME or start[0] > LAST_UNIT:
        return 0
    for direction in _SENDERS:
        size = frame_size(start, direction)
        if size and size <= len(start) and crc(start[:size]) == 0:
            return size
    return 0


def _mbap_frames(data: bytes) -> list[tuple[Transport, bytes]]:
    found = []
    at = 0
    while at < len(data):
        header = data[at : at + _MIN_MBAP]
        if len(header) < _MIN_MBAP or header[2:4] != b"\0\0":
            return []
        size = mbap_size(header)
        raw = data[at : at + size]
        if size < _MIN_MBAP or len(raw) < size or not forms(Transport.TCP, raw):
            return []
        if raw[7] & ~EXCEPTION_BIT not in FUNCTIONS:
            return []
        found.append((Transport.TCP, raw))
        at += size
    return found


def _ascii_frames(data: bytes) -> list[tuple[Transport, bytes]]:
    found = []
    at = 0
    while match := _ASCII.match(data, at):
        raw = match[0].rstrip(b"\r\n") + b"\r\n"
        frame = read_frame(raw)
        if frame is None or not frame.checksum.ok or frame.body[0] > LAST_UNIT:
            return []
        if not forms(Transport.ASCII, raw):
            return []
        found.append((Transport.ASCII, raw))
        at = match.end()
    return found if at == len(data) else []
