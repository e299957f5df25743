"""Finds the time in a line of a log, and the word or arrow that names the sender."""

# Times are UTC unless the line names an offset. A time without a date counts from 1970-01-01, and
# from the next day on when it goes back by more than half a day. A syslog time has no year; it is
# in 1970. Times in seconds, and milliseconds since the boot of a device, count from 1970.
# A number in brackets is such a time if it has 4 digits or more; fewer are of a port or a unit.
# A number of 10, 13, 16 or 19 digits that is a time from 2008 to 2033 in s, ms, us or ns is that
# time. It needs no fraction and no brackets.
#
# Dates like 12/02/2024 and 12-02-2024 have one order in a file. Two things show this order: a
# number above 12, and two consecutive dates with one equal number, as midnight changes the day and
# not the month. Earlier dates are read with the month first, unless all are in the first READ_BYTES
# of the file. A date in the other order is no time. If a file never shows its order, its dates are
# read with the month first, and the user is told so.
#
# A time is searched only before the bytes: a date with a time of day anywhere, a number only at the
# beginning of the line.

from __future__ import annotations

import re
from calendar import timegm
from collections.abc import Callable
from functools import lru_cache
from typing import NamedTuple

MAX_TIME_NS = 1 << 62
NEAR = 120
"""A mark is looked for in this many characters next to the bytes."""
LOOKED_AT = 120
"""A time is looked for in this many characters at the front of a line."""

_MONTH = rb"(jan|feb|mar|apr|may|jun|jul|aug|sep|oct|nov|dec)"
_CLOCK = rb"(\d{1,2}):(\d\d):(\d\d)(?:[.,:](\d{1,9}))?(?!\d|:\d)"
_MONTHS = {
    name: number
    for number, name in enumerate(b"jan feb mar apr may jun jul aug sep oct nov dec".split(), 1)
}


class Time(NamedTuple):
    """The place of a time in a line, and how to read it."""

    start: int
    end: int
    read: Callable[[bytes], int]
    """Reads the text of the place; returns ns. Raises ValueError if it is no time."""
    is_clock: bool
    """True for a time of day without a date."""
    is_number: bool = False
    """True for seconds or milliseconds, which are mere digits."""


def iso_ns(text: bytes) -> int:
    """Read 2024-01-20 12:00:00.123+01:00 to ns. Raises ValueError for another text."""
    rest = text[19:]
    if rest[:1] == b" " and rest[1:2].isdigit():
        raise ValueError
    ns = _second_ns(text[:19])
    if not rest:
        return ns
    match = _FRACTION.match(rest)
    if match is None:
        raise ValueError
    fraction, zone = match.groups()
    ns += int(fraction.ljust(9, b"0")) if fraction else 0
    if zone and zone != b"Z":
        digits = zone[1:].replace(b":", b"")
        shift = int(digits[:2]) * 3600 + int(digits[2:] or b"0") * 60
        ns += (-shift if zone[:1] == b"+" else shift) * 10**9
    return ns


@lru_cache(maxsize=1024)
def _second_ns(text: bytes) -> int:
    """Read a date and a time in seconds, 2024-01-20 12:00:00, to ns."""
    clock = _clock_ns(text[11:13], text[14:16], text[17:19], None)
    return _date_ns(text[:4], text[5:7], text[8:10]) + clock


def _day_first(text: bytes) -> int:
    match = _SHORT.match(text)
    if match is None:
        raise ValueError
    day, _, month, year, hours, minutes, seconds, fraction, half = match.groups()
    if not 1 <= int(month) <= 12:
        raise ValueError("no month")
    clock_ns = _clock_ns(hours, minutes, seconds, fraction)
    if half:
        clock_ns += (12 * (half[:1] in b"pP") - 12 * (int(hours) == 12)) * 3600 * 10**9
    return _date_ns(year, month, day) + clock_ns


def _syslog(text: bytes) -> int:
    match = _SYSLOG.match(text)
    if match is None:
        raise ValueError
    month, day, year, *clock = match.groups()
    return _date_ns(year or b"1970", b"%d" % _MONTHS[month.lower()], day) + _clock_ns(*clock)


def _day_month(text: bytes) -> int:
    match = _DAY_MONTH.match(text)
    if match is None:
        raise ValueError
    day, month, year, *clock = match.groups()
    return _date_ns(year, b"%d" % _MONTHS[month.lower()], day) + _clock_ns(*clock)


def _clock(text: bytes) -> int:
    match = _OF_DAY.match(text)
    if match is None:
        raise ValueError
    return _clock_ns(*match.groups())


def _seconds(text: bytes) -> int:
    whole, _, fraction = text.replace(b",", b".").partition(b".")
    return int(whole) * 10**9 + int(fraction[:9].ljust(9, b"0"))


def _milliseconds(text: bytes) -> int:
    return int(text) * 10**6


def _since_1970(text: bytes) -> int:
    """Read a number of 10, 13, 16 or 19 digits, in s, ms, us or ns."""
    return int(text.ljust(19, b"0"))


_ISO = re.compile(
    rb"\d{4}[-/.]\d\d[-/.]\d\d[ T_,]\d\d:\d\d:\d\d(?:[.,:]\d{1,9})?(?: ?(?:Z|[+-]\d\d:?\d\d))?"
    rb"(?!\d|:\d)"
)
_FRACTION = re.compile(rb"(?:[.,:](\d{1,9}))? ?(Z|[+-]\d\d:?\d\d)?")
_SHORT = re.compile(
    rb"(?<!\d)(\d{1,2})([./-])(\d{1,2})[./-](\d{4}),?[ T]{1,2}" + _CLOCK + rb"(?: ?([aApP][mM]))?"
)
_SLASHED = re.compile(
    rb"(?<!\d)(\d{1,2})(?P<mark>[/-])(\d{1,2})(?=(?P=mark)\d{4},?[ T]{1,2}\d{1,2}:)"
)
_SYSLOG = re.compile(rb"(?i)\b" + _MONTH + rb"\s+(\d{1,2})(?:,? (\d{4}))?,? +" + _CLOCK)
_DAY_MONTH = re.compile(rb"(?i)\b(\d{1,2})[ /-]" + _MONTH + rb"[ /-](\d{4})[ :T]" + _CLOCK)
_OF_DAY = re.compile(rb"(?<![\d:.])" + _CLOCK)
_FORMS: tuple[tuple[re.Pattern[bytes], Callable[[bytes], int], int, bool], ...] = (
    (_ISO, iso_ns, 0, False),
    (_SHORT, _day_first, 0, False),
    (_SYSLOG, _syslog, 0, False),
    (_DAY_MONTH, _day_month, 0, False),
    (re.compile(rb"()()" + _OF_DAY.pattern), _clock, 0, True),
)
_AT_FRONT: tuple[tuple[re.Pattern[bytes], Callable[[bytes], int]], ...] = (
    (
        re.compile(
            rb"\W{0,2}\s*(1[2-9]\d{8}(?:\d{3}(?:\d{3}(?:\d{3})?)?)?)(?!\d|\.\d|,\d{3,9}(?!\w)|[A-Za-z_])"
        ),
        _since_1970,
    ),
    (
        re.compile(rb"\s*[\[(]?\s*(\d{1,10}[.,]\d{3,9}|1[2-9]\d{8}\.\d{1,2})(?![\d.]|[A-Za-z_])"),
        _seconds,
    ),
    (re.compile(rb"\s*(\d{1,12}) ?ms\b"), _milliseconds),
    (re.compile(rb"[\[(]\s*(\d{4,12})\s?[\])]"), _milliseconds),
)


def find_time(line: bytes) -> Time | None:
    """Return the time at the front of a line; None if it has none."""
    front = line[:LOOKED_AT]
    for pattern, read, group, is_clock in _FORMS:
        match = pattern.search(front)
        if match is not None:
            return Time(*match.span(group), read, is_clock)
    for pattern, read in _AT_FRONT:
        match = pattern.match(front)
        if match is not None:
            return Time(*match.span(1), read, is_clock=False, is_number=True)
    return None


class DateOrder:
    """Reads times, with one order of day and month in all dates like 12/02/2024 of a file."""

    def __init__(self) -> None:
        self._has_day_first: bool | None = None
        """True if the day comes before the month, False if not; None until a date has shown the
        order."""
        self._last: tuple[int, int] | None = None
        self.guessed = b""
        """The first date that was read month first without a date that shows it; empty if none."""

    @property
    def is_guessed(self) -> bool:
        """True if dates were read of which nothing in the file shows the order."""
        return self._has_day_first is None and bool(self.guessed)

    def note(self, text: bytes) -> None:
        """Decide the order by the first date of a text that shows it."""
        for match in _SLASHED.finditer(text):
            if self._has_day_first is not None:
                return
            last, self._last = self._last, (int(match[1]), int(match[3]))
            if max(self._last) > 12:
                self._has_day_first = self._last[0] > 12
            elif last is not None and (last[0] == self._last[0]) != (last[1] == self._last[1]):
                self._has_day_first = last[1] == self._last[1]

    def read(self, time: Time, text: bytes) -> int:
        """Read the text of a time to ns. Raises ValueError if it is no time."""
        if time.read is _day_first:
            if self._has_day_first is None:
                self.note(text)
            if not self._has_day_first:
                if self._has_day_first is None and not self.guessed and _SLASHED.match(text):
                    self.guessed = text[:10].rstrip()
                text = _SLASHED.sub(rb"\3\2\1", text)
        return time.read(text)


@lru_cache(maxsize=256)
def _date_ns(year: bytes, month: bytes, day: bytes) -> int:
    return timegm((int(year), int(month), int(day), 0, 0, 0)) * 10**9


def _clock_ns(hours: bytes, minutes: bytes, seconds: bytes, fraction: bytes | None) -> int:
    second = int(hours) * 3600 + int(minutes) * 60 + int(seconds)
    return second * 10**9 + int((fraction or b"0").ljust(9, b"0"))


_STRONG = re.compile(
    rb"(?i)(?P<sent>(?<![a-z])(?:sen(?:d|t|ding)(?:to|msg)?|txd?|transmit\w*|req(?:uest)?|query|queries|>>+|-+>|=+>"
    rb"|\xe2\x86\x92|\xe2\x9f\xb6)(?![a-z])|^\s*>\s)"
    rb"|(?P<received>(?<![a-z])(?:rec(?:v|eive|eived|eiving)(?:from|msg)?|rcvd?|rxd?|resp(?:onse|ond|onded)?|rsp|answer|reply|replied"
    rb"|<<+|<-+|<=+|\xe2\x86\x90|\xe2\x9f\xb5)(?![a-z])|^\s*<\s)"
)
_WEAK = re.compile(
    rb"(?i)(?<![a-z])(?:(?P<sent>writ(?:e|es|ing|ten)|wrote|master|output|out)"
    rb"|(?P<received>read(?:ing)?|slave|input|in|got))(?![a-z])"
)
"""Words that also have other meanings: such a word is taken for a mark only if the text has none of
_STRONG."""


class Mark(NamedTuple):
    """A word or an arrow that says who sent."""

    word: bytes
    is_sent: bool
    """True if the word stands for what the program sends, False for what it receives. In the log of
    a slave, what is received is the request."""
    is_strong: bool = True
    """False for a word that has other meanings, too, and for one behind the bytes."""


_NUMBERS = b"0123456789"
_BRACKETS = {b"[00][00][00][00]": Mark(b"[]", True), b"<00><00><00><00>": Mark(b"<>", False)}
"""What libmodbus puts around the bytes that it sends and receives."""


def bracket_mark(shape: bytes) -> Mark | None:
    """Return the mark that brackets around each byte are; None if bytes are written otherwise."""
    return _BRACKETS.get(shape[:16])


def find_mark(text: bytes, *, last: bool = True, is_strong: bool = False) -> Mark | None:
    """Return the last mark in a text, or the first one; None if there is none.

    With `is_strong`, words that have other meanings, too, do not count. Only the NEAR characters at
    that end of the text are looked at.
    """
    near = text[-NEAR:] if last else text[:NEAR]
    return _find_mark(near.translate(None, _NUMBERS), last, is_strong)


@lru_cache(maxsize=1024)
def _find_mark(text: bytes, last: bool, is_strong: bool) -> Mark | None:
    for pattern in (_STRONG,) if is_strong else (_STRONG, _WEAK):
        every = [*pattern.finditer(text)]
        if every:
            found = every[-1 if last else 0]
            is_sent = found["sent"] is not None
            strong = pattern is _STRONG and last
            return Mark(found[0].strip().lower(), is_sent, strong)
    return None
