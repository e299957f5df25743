"""The limits of the rules about attacks and scans: a number of cases within a time."""

# The default limits are chosen so that ordinary operation stays below them; docs/findings.md gives
# the reason for each. The module that checks a rule says which cases it counts.

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass
from decimal import Decimal
from typing import Self

from mbtool.core import UsageError
from mbtool.core.moments import DAY_NS, SECOND_NS

MAX_NUMBER = 4096
"""The largest number of cases in a limit: a rule keeps the time of each case in memory."""
MAX_WINDOW_NS = DAY_NS

_UNITS_NS = {
    "ms": 1_000_000,
    "s": SECOND_NS,
    "min": 60 * SECOND_NS,
    "h": 3600 * SECOND_NS,
}
_PATTERN = re.compile(
    r"(?P<code>[^=]+)=(?P<number>\d{1,6})/(?P<time>\d{1,8}(?:\.\d{1,3})?) ?(?P<unit>ms|s|min|h)",
    re.ASCII,
)


@dataclass(frozen=True, slots=True)
class SecurityLimit:
    """The limit of a rule: at least `number` cases within `window_ns` nanoseconds are a finding."""

    number: int
    window_ns: int


@dataclass(frozen=True, slots=True)
class SecurityLimits:
    """The limit of each rule about attacks and scans."""

    second_writer: SecurityLimit = SecurityLimit(1, 10 * SECOND_NS)
    write_flood: SecurityLimit = SecurityLimit(300, 5 * SECOND_NS)
    """The limit for the writes of one master to one slave on a network (SEC-102)."""
    line_write_flood: SecurityLimit = SecurityLimit(150, 5 * SECOND_NS)
    """The limit for all writes on a serial line (SEC-102). It is lower than that for networks,
    because a line carries only about 40 writes per second at 9600 baud."""
    stop_command: SecurityLimit = SecurityLimit(1, 60 * SECOND_NS)
    host_scan: SecurityLimit = SecurityLimit(10, 60 * SECOND_NS)
    unit_scan: SecurityLimit = SecurityLimit(10, 60 * SECOND_NS)
    function_scan: SecurityLimit = SecurityLimit(8, 60 * SECOND_NS)
    register_scan: SecurityLimit = SecurityLimit(20, 60 * SECOND_NS)
    identification: SecurityLimit = SecurityLimit(1, 300 * SECOND_NS)

    @classmethod
    def parse(cls, texts: Iterable[str]) -> Self:
        """Read texts such as `SEC-201=20/60s`: the code of a rule, a number of cases, a time.

        A rule that no text names keeps its default limit. Raises UsageError for a text of another
        form, and for a rule that is named twice.
        """
        limits: dict[str, SecurityLimit] = {}
        for text in texts:
            code, limit = _parse(text)
            for name in _FIELDS[code]:
                if name in limits:
                    raise UsageError(f"--limit: {code} is named twice")
                limits[name] = limit
        return cls(**limits)


_FIELDS = {
    "SEC-101": ("second_writer",),
    "SEC-102": ("write_flood", "line_write_flood"),
    "SEC-103": ("stop_command",),
    "SEC-201": ("host_scan",),
    "SEC-202": ("unit_scan",),
    "SEC-203": ("function_scan",),
    "SEC-204": ("register_scan",),
    "SEC-205": ("identification",),
}
"""The fields of SecurityLimits that a user's limit sets, by the code of the rule."""


def _parse(text: str) -> tuple[str, SecurityLimit]:
    match = _PATTERN.fullmatch(text.strip())
    if match is None:
        raise UsageError(
            f"--limit: {text!r} is no limit; write CODE=NUMBER/TIME, for example SEC-201=20/60s, "
            "with a time in ms, s, min or h"
        )
    code = match["code"].strip().upper()
    if code not in _FIELDS:
        codes = ", ".join(_FIELDS)
        raise UsageError(f"--limit: {match['code']!r} has no limit; those that have: {codes}")
    number = int(match["number"])
    if not 1 <= number <= MAX_NUMBER:
        raise UsageError(f"--limit: {text!r}: the number is from 1 to {MAX_NUMBER}")
    window_ns = int(Decimal(match["time"]) * _UNITS_NS[match["unit"]])
    if not _UNITS_NS["ms"] <= window_ns <= MAX_WINDOW_NS:
        raise UsageError(f"--limit: {text!r}: the time is from 1ms to 24h")
    return code, SecurityLimit(number, window_ns)
