"""Reads what a user saw on a display: `23.4`, `Voltage=236.8+-0.5V@10:15:03`."""

#     [NAME=]NUMBER[+-TOLERANCE][UNIT][@TIME]
#
# A number stands for the range that a display rounds to it: 23.4 is 23.35 to 23.45. Numbers with
# the same name were seen on one display; so were numbers without a name that have a time. Any other
# number is on a display of its own. A time is a date and time, a time since the recording began, or
# a time of day.
#
# A file of such numbers has a row for each time, separated by commas, semicolons or tabs: the time,
# then a number for each display. A first row of words has the names of the displays.

from __future__ import annotations

import csv
import re
from collections.abc import Iterator, Sequence
from decimal import Decimal, InvalidOperation
from itertools import chain
from typing import NamedTuple

from mbtool.core.errors import UsageError
from mbtool.core.moments import DAY_NS, SECOND_NS, TimePoint, parse_moment
from mbtool.values.finding import Sighting, Wanted

MAX_SEEN = 10_000
"""A user can give at most this many numbers."""
MAX_POWER = 30
"""The first digit of a number stands at most at this power of ten, and its last digit at least at
the same power below zero: up to about 1e30, in steps of at least 1e-30."""
AROUND_NS = 60 * SECOND_NS
"""A time of day up to this long before a recording (ns) is not one of the next day."""

_NUMBER = r"[+-]?(?:\d+(?:\.\d*)?|\.\d+)(?:[eE][+-]?\d+)?"
_SEEN = re.compile(
    rf"(?P<number>{_NUMBER})\s*(?:(?:\+-|\+/-|±)\s*(?P<tolerance>\d+(?:\.\d+)?))?"
    r"\s*(?P<unit>[A-Za-z%°µΩ‰][^@=]*)?(?:@(?P<time>.+))?"
)
_CLOCK = re.compile(r"(\d{1,2}):(\d{2})(?::(\d{2})(\.\d{1,9})?)?")
_EXAMPLE = "write a number as the display shows it, such as 23.4, Voltage=236.8V or 23.4@10:15:03"


class SeenTime(NamedTuple):
    """When a number was seen, as the user gave it."""

    point: TimePoint | None
    clock_ns: int | None = None
    """The time since 00:00 UTC, if the user gave a time of day."""

    def at_ns(self, first_ns: int) -> int:
        """The time (UTC ns) in a recording that begins at `first_ns`.

        A time of day is the first such one since AROUND_NS before the recording.
        """
        if self.point is not None:
            return self.point.ns if self.point.is_absolute else first_ns + self.point.ns
        least_ns = first_ns - AROUND_NS
        return least_ns + ((self.clock_ns or 0) - least_ns) % DAY_NS


class Seen(NamedTuple):
    """A number that a user saw."""

    name: str
    value: float
    tolerance: float
    unit: str
    time: SeenTime | None


def parse_seen(text: str) -> Seen:
    """Read one number. Raises UsageError if the text is no number."""
    name, _, rest = text.rpartition("=")
    match = _SEEN.fullmatch(rest.strip())
    if match is None:
        raise UsageError(f"{text!r}: {_EXAMPLE}")
    value, step = _number(match["number"], text)
    tolerance, _ = _number(match["tolerance"] or "0", text)
    time = None if match["time"] is None else parse_time(match["time"])
    return Seen(name.strip(), value, max(tolerance, step / 2), (match["unit"] or "").strip(), time)


def _number(number: str, text: str) -> tuple[float, float]:
    """Return a number and the step of its last digit; `text` is shown in an error."""
    try:
        value = Decimal(number)
        exponent = value.as_tuple().exponent
        if isinstance(exponent, int) and exponent >= -MAX_POWER and value.adjusted() <= MAX_POWER:
            return float(value), float(Decimal(1).scaleb(exponent))
    except InvalidOperation:  # Its exponent has twenty digits.
        pass
    raise UsageError(
        f"{text[:40]!r}: a number has a size of at most 1e{MAX_POWER}, and digits down to "
        f"1e-{MAX_POWER}"
    )


def parse_time(text: str) -> SeenTime:
    """Read the time at which something was seen. Raises UsageError if the text is no time."""
    clock = _CLOCK.fullmatch(text.strip())
    if clock is None:
        return SeenTime(parse_moment(text.strip(), "time"))
    hours, minutes, seconds = (int(one or 0) for one in clock.groups()[:3])
    if hours > 23 or minutes > 59 or seconds > 59:
        raise UsageError(f"time {text!r}: there is no such time of day")
    fraction_ns = int(float(clock[4] or 0) * SECOND_NS)
    return SeenTime(None, ((hours * 60 + minutes) * 60 + seconds) * SECOND_NS + fraction_ns)


def parse_table(text: str, file: str) -> list[Seen]:
    """Read a file of numbers with their times. Raises UsageError if it has another form."""
    lines = [line for line in text.splitlines() if line.strip() and not line.startswith("#")]
    if not lines:
        raise UsageError(f"{file}: no numbers; a row has a time and a number: 10:15:03,23.4")
    separator = next((one for one in "\t;," if one in lines[0]), ",")
    rows = csv.reader(lines, delimiter=separator, skipinitialspace=True)
    try:
        return _numbers(rows, file)
    except csv.Error as error:
        raise UsageError(f"{file}: row {rows.line_num}: {error}") from error


def _numbers(rows: Iterator[list[str]], file: str) -> list[Seen]:
    first = next(rows)
    names = [one.strip() for one in first[1:]]
    if any(_SEEN.fullmatch(name) for name in names):
        names = [f"column {at}" if at > 1 else "value" for at in range(1, len(names) + 1)]
        rows = chain([first], rows)
    found: list[Seen] = []
    for row in rows:
        for name, number in zip(names, row[1:], strict=False):
            if number.strip():
                if len(found) == MAX_SEEN:
                    raise UsageError(
                        f"{file}: more numbers than {MAX_SEEN:,}, the most that can be looked for"
                    )
                seen = parse_seen(number)
                found.append(seen._replace(name=name, time=parse_time(row[0])))
    return found


def wanted_of(seen: Sequence[Seen], first_ns: int) -> list[Wanted]:
    """Join the numbers of each display; `first_ns` is the beginning of the recording (UTC ns)."""
    groups: dict[tuple[str, int], list[Seen]] = {}
    for place, one in enumerate(seen):
        is_alone = not one.name and one.time is None
        groups.setdefault((one.name, place if is_alone else -1), []).append(one)
    return [
        Wanted(
            own[0].name,
            [
                Sighting(
                    one.value,
                    one.tolerance,
                    None if one.time is None else one.time.at_ns(first_ns),
                )
                for one in own
            ],
            next((one.unit for one in own if one.unit), ""),
        )
        for own in groups.values()
    ]
