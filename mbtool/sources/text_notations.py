"""Finds bytes in a line of text, in every notation that programs use."""

# The shape of a line is the line with 0 in place of every hexadecimal digit. So a pattern needs no
# classes of digits, and lines that differ only in digits have one shape, whose places are found
# only once (text_log.py). NOTATIONS is the whole list; a new notation is one row.
#
# If two notations find bytes at overlapping places, the one with more bytes wins. Text in quotes
# with escapes (\x01, \1, \n) and lists of decimal numbers are read from the line itself.

from __future__ import annotations

import re
from typing import TYPE_CHECKING, NamedTuple

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

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


def _long(text: bytes) -> bytes:
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
        _long,
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
"""What strace writes in front of the bytes that a call reads or writes."""
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
    places = [one for each in NOTATIONS for one in _found(each, shape, skip_to)]
    if all(_size(shape, one) < MIN_PURE for one in places):
        places += _found(_GROUPS, shape, skip_to)
    places.sort(key=lambda one: one.start - one.end)
    chosen: list[FoundBytes] = []
    for one in places:
        if all(one.end <= other.start or other.end <= one.start for other in chosen):
            chosen.append(one)
    if not chosen:
        single = _SINGLE.search(shape, skip_to)
        if single is not None:
            chosen.append(FoundBytes(*single.span(1), _digits))
    if b"\\" in line or b'(0, "' in shape:
        chosen += _quoted(line, skip_to)
    chosen += _found(_DECIMALS, shape, skip_to) + _found(_BARE_DECIMALS, shape, skip_to)
    return sorted(chosen, key=lambda one: one.start)


def _found(notation: Notation, shape: bytes, skip_to: int) -> list[FoundBytes]:
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
