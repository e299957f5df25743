"""Drafts a device profile from the observed traffic of a slave."""

# The draft has the functions and addresses that the slave accepted, and its exception codes. It
# leaves out functions that the slave refused with exception 01, and addresses that it refused with
# 02 or 03. Addresses without any response are in the draft, with a comment. judging.py finds the
# types of registers: a comment gives the reason for each type, and asks a question if the type
# cannot be known.
#
# Limit: MAX_POINTS points. A comment gives the number of the remaining registers.

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from itertools import groupby
from operator import itemgetter
from pathlib import PurePath
from typing import TYPE_CHECKING

import msgspec

from mbtool.core.moments import counted
from mbtool.devices.dumping import dump_profile
from mbtool.devices.model import Access, Area, Exceptions, FunctionRule, Point, Profile
from mbtool.devices.point_types import ByteOrder, PointType, WordOrder
from mbtool.devices.references import SHORT_WORDS, write_reference
from mbtool.devices.validation import validate
from mbtool.modbus.functions import FUNCTIONS, ExceptionCode, exception_name, function_name
from mbtool.modbus.tables import Table
from mbtool.values.judging import Judged, judge
from mbtool.values.reasons import ValueRole
from mbtool.values.value_series import histories_of

if TYPE_CHECKING:
    from mbtool.devices.observed_slave import ObservedRequest, ObservedSlave, Replies

MAX_POINTS = 1000
"""The most points of a drafted profile; a comment gives the number of the remaining registers."""
MAX_LISTED = 24
"""A comment lists at most this many addresses or ranges."""

_NO_FUNCTION = ExceptionCode.ILLEGAL_FUNCTION
_WRONG_VALUE = ExceptionCode.ILLEGAL_DATA_VALUE
_REFUSALS = frozenset((_NO_FUNCTION, ExceptionCode.ILLEGAL_DATA_ADDRESS, _WRONG_VALUE))
_READ, _WRITTEN, _NO_RESPONSE = 1, 2, 4
"""Bits of an address's flags: a request read the address; a request wrote it; no request for it had
a response."""


@dataclass(frozen=True, slots=True)
class Draft:
    """A drafted profile, and its text as a TOML file with comments."""

    profile: Profile
    text: str


def draft_profile(
    seen: ObservedSlave, name: str, file: str, known: Sequence[tuple[Point, str]] = ()
) -> Draft:
    """Draft a profile of the slave. Never raises.

    `name` becomes the name of the profile. `file` is the path of the capture, which comments name.
    `known` has points that are known, each with its comment; they stand in place of guesses.
    """
    file = PurePath(file).name
    flags = _address_flags(seen)
    comments: dict[str, list[str]] = {}
    areas = [area for table in Table for area in _areas(table, flags[table], seen, comments)]
    functions, comments["functions"] = _functions(seen)
    profile = Profile(
        name=name,
        title=_title(seen),
        vendor=seen.identity.get("vendor") or "unknown",
        transports=sorted(seen.transports),
        source=f"traffic of {_slave_text(seen)} in {file}",
        areas=areas,
        functions=functions,
        exceptions=Exceptions(documented=sorted({*map(int, _REFUSALS), *_exceptions(seen)})),
    )
    points, left_out = _points(profile, seen, comments, known)
    profile = msgspec.structs.replace(profile, points=points)
    comments[""] = _head(seen, file, left_out)
    validate(profile, name)
    return Draft(profile, dump_profile(profile, comments))


def _title(seen: ObservedSlave) -> str:
    names = ("product", "model", "product code")
    return next((seen.identity[one] for one in names if seen.identity.get(one)), _slave_text(seen))


def _slave_text(seen: ObservedSlave) -> str:
    at = f" at {seen.who.host}" if seen.who.host is not None else ""
    return f"unit {seen.unit}{at}"


def _head(seen: ObservedSlave, file: str, left_out: int) -> list[str]:
    head = [
        f"Drafted by mbtool from what {_slave_text(seen)} was asked and answered in {file}, "
        f"{counted(seen.transactions, 'transaction')}. It knows no more than that: an address or "
        "a function that nobody asked for is missing here. Types of registers are guesses, with "
        "the reason above each; give the points their names, and correct what the manual says "
        "otherwise. HR10 is holding register 10 on the wire; if the manual calls it 40011, set "
        "prefix and base so.",
    ]
    head += [f"It calls its {name} {text!r}." for name, text in seen.identity.items()]
    if left_out:
        head.append(
            f"{left_out} more registers were seen; only the first {MAX_POINTS} points are here."
        )
    if seen.forgotten:
        head.append(f"{seen.forgotten} transactions of too many kinds were not looked at.")
    return head


def _address_flags(seen: ObservedSlave) -> dict[Table, bytearray]:
    """Return the flags (_READ, _WRITTEN, _NO_RESPONSE) of each address, by table.

    The flags are 0 if nobody requested the address, or the slave refused every request for it.
    """
    flags = {table: bytearray(1 << 16) for table in Table}
    for request, replies in seen.requests.items():
        if request.table is None or request.address is None:
            continue
        flag = 0
        if replies.ok:
            flag = _WRITTEN if request.writes else _READ
        elif _REFUSALS.isdisjoint(replies.exceptions):
            flag = _NO_RESPONSE | (_WRITTEN if request.writes else _READ)
        of_table = flags[request.table]
        for address in request.span if flag else ():
            of_table[address] = _combine_flags(of_table[address], flag)
    return flags


def _combine_flags(known: int, flag: int) -> int:
    """Combine the flags of one address that follow from two requests: `known` and `flag`.

    _NO_RESPONSE stays only if neither request had a response.
    """
    if not known or known & flag & _NO_RESPONSE:
        return known | flag
    return (known | flag) & ~_NO_RESPONSE


def _areas(
    table: Table, flags: bytearray, seen: ObservedSlave, comments: dict[str, list[str]]
) -> Iterator[Area]:
    refused = [
        (request, replies)
        for request, replies in seen.requests.items()
        if request.table is table and not replies.ok and replies.exceptions
    ]
    prefix = SHORT_WORDS[table]
    for first, last in _runs(flags):
        of_area = flags[first : last + 1]
        written = any(flag & _WRITTEN for flag in of_area)
        area = Area(
            name=f"{prefix}{first}..{last}" if last > first else f"{prefix}{first}",
            table=table,
            first=first,
            last=last,
            access=Access.READ_WRITE if written else Access.READ,
            prefix=prefix,
        )
        comments[f'areas "{area.name}"'] = list(_about_area(area, of_area, refused))
        yield area


def _runs(flags: bytearray) -> Iterator[tuple[int, int]]:
    """Give the first and last address of each range of addresses whose flags are not 0.

    The slave responded to requests for all addresses of a range, or for none of them.
    """
    kinds = ((0 if not flag else 2 if flag & _NO_RESPONSE else 1) for flag in flags)
    for kind, group in groupby(enumerate(kinds), key=itemgetter(1)):
        if kind:
            addresses = [address for address, _ in group]
            yield addresses[0], addresses[-1]


def _about_area(
    area: Area, flags: bytearray, refused: Sequence[tuple[ObservedRequest, Replies]]
) -> Iterator[str]:
    """Yield comments on an area: which addresses were never written or read, and which requests for
    neighbouring addresses the slave refused.

    `flags` has the flags of each address in the area; `refused` has the refused requests for the
    area's table, with the slave's replies.
    """
    if flags[0] & _NO_RESPONSE:
        yield "Asked for, but never answered: perhaps there is nothing here."
    if area.access is Access.READ and area.table.is_writable:
        yield "Nobody wrote here; if the device allows it, access is rw."
    elif area.access is Access.READ_WRITE:
        written = [area.first + at for at, flag in enumerate(flags) if flag & _WRITTEN]
        yield f"Written here: {_ranges_text(written)}."
        if not any(flag & _READ for flag in flags):
            yield "Never read here."
    adjacent = [
        f"{write_reference(None, area.table, request.address or 0, request.quantity)} "
        f"(exception {next(iter(replies.exceptions)):02X})"
        for request, replies in refused
        if request.span.start <= area.last + 1 and request.span.stop >= area.first
    ]
    if adjacent:
        yield f"Refused beside it: {', '.join(adjacent[:MAX_LISTED])}."


def _ranges_text(addresses: Sequence[int]) -> str:
    """Write addresses as ranges, which include their last address: `1, 3..5, 8`."""
    runs: list[list[int]] = []
    for address in addresses:
        if runs and address == runs[-1][1] + 1:
            runs[-1][1] = address
        else:
            runs.append([address, address])
    shown = [f"{a}..{b}" if b > a else f"{a}" for a, b in runs[:MAX_LISTED]]
    return ", ".join(shown) + (" and more" if len(runs) > MAX_LISTED else "")


@dataclass(slots=True)
class _Function:
    """Counts the slave's responses to requests with one function."""

    ok: int = 0
    silent: int = 0
    most: int = 0
    """The largest quantity that the slave accepted."""
    refused: Counter[int] = field(default_factory=Counter)
    """Number of requests that the slave refused, by exception code."""
    least_refused: int = 1 << 16
    """The smallest quantity that the slave refused with exception 03, although it accepted other
    requests for the same addresses; 1 << 16 if there is none."""


def _functions(seen: ObservedSlave) -> tuple[dict[str, FunctionRule], list[str]]:
    """Return rules for the functions that the slave may have, and comments on all requested
    functions.

    The key of a rule is the function code as two hexadecimal digits. A function is left out if the
    slave refused it with exception 01 and never accepted it.
    """
    rules: dict[str, FunctionRule] = {}
    comments: list[str] = []
    for code, one in sorted(_observed_functions(seen).items()):
        phrases = list(_about_function(code, one))
        if not one.ok and _NO_FUNCTION in one.refused:
            phrases.append("so not listed")
        else:
            limit = _limit(code, one)
            if limit is not None:
                phrases.append(f"{one.least_refused} are refused, so {limit} is taken as its limit")
            rules[f"{code:02X}"] = FunctionRule(limit=limit)
        comments.append(", ".join(phrases))
    return rules, comments


def _observed_functions(seen: ObservedSlave) -> dict[int, _Function]:
    functions: dict[int, _Function] = {}
    for request, replies in seen.requests.items():
        one = functions.setdefault(request.function, _Function())
        one.ok += replies.ok
        one.silent += replies.silent
        one.refused += replies.exceptions
        if replies.ok:
            one.most = max(one.most, request.quantity)
    known = seen.known_addresses()
    for request, replies in seen.requests.items():
        if request.table is None or replies.ok or _WRONG_VALUE not in replies.exceptions:
            continue
        if all(known[request.table][request.span.start : request.span.stop]):
            one = functions[request.function]
            one.least_refused = min(one.least_refused, request.quantity)
    return functions


def _about_function(code: int, one: _Function) -> Iterator[str]:
    known = FUNCTIONS.get(code)
    yield f"{code:02X} {function_name(code)}: answered {counted(one.ok, 'time')}"
    if one.ok and known is not None and known.limit > 1 and known.table is not None:
        yield f"{one.most} at most"
    for exception, count in sorted(one.refused.items()):
        yield f"exception {exception:02X} {exception_name(exception)} {counted(count, 'time')}"
    if one.silent:
        yield f"{counted(one.silent, 'time')} no answer"


def _limit(code: int, one: _Function) -> int | None:
    """Return the limit of the quantity in requests with the function `code`.

    It is the largest quantity that the slave accepted, if the slave refused a larger one; otherwise
    None.
    """
    known = FUNCTIONS.get(code)
    if known is None or not 0 < one.most < one.least_refused < known.limit:
        return None
    return one.most


def _exceptions(seen: ObservedSlave) -> set[int]:
    return {code for one in seen.requests.values() for code in one.exceptions if 1 <= code <= 0xFF}


def _points(
    profile: Profile,
    seen: ObservedSlave,
    comments: dict[str, list[str]],
    known: Sequence[tuple[Point, str]],
) -> tuple[list[Point], int]:
    """Return points for the registers whose values were sampled, at most MAX_POINTS, and the number
    of registers that get no point because of this limit.

    Adds the reason for the type of each point to `comments`, under the key `points "NAME"`.
    """
    points = [point for point, _ in known]
    comments.update({f'points "{point.name}"': [comment] for point, comment in known})
    taken = {(point.table, at) for point, _ in known for at in point.all_addresses}
    left_out = 0
    for one in judge(histories_of(seen)):
        if any((one.table, one.address + at) in taken for at in range(one.words)):
            continue
        if not profile.area(one.table, one.address, one.words):
            continue
        if len(points) >= MAX_POINTS:
            left_out += one.words
            continue
        point = _point(one)
        comments[f'points "{point.name}"'] = list(_about_point(one))
        points.append(point)
    tables = list(Table)
    points.sort(key=lambda point: (tables.index(point.table), point.address))
    return points, left_out


def _point(one: Judged) -> Point:
    is_text = one.reading.type is PointType.STRING
    return Point(
        name=f"{SHORT_WORDS[one.table]}{one.address}",
        table=one.table,
        address=one.address,
        type=one.reading.type,
        length=one.words if is_text else None,
        word_order=WordOrder.HIGH_FIRST if one.words == 1 or is_text else one.reading.order.words,
        byte_order=ByteOrder.HIGH_FIRST if one.words == 1 or is_text else one.reading.order.bytes,
    )


def _about_point(one: Judged) -> Iterator[str]:
    """Yield the reason for the type of a point, and what is to be asked where it is not sure."""
    if one.reading.type is PointType.UINT16 and one.words == 1:
        yield f"Seen: {one.reason}."
    else:
        yield f"A guess, {_percent(one)}: {one.reason}."
    if one.is_sure or one.role is ValueRole.CONSTANT:
        return
    if one.words > 1:
        yield "To be asked: is this one value? mbtool find tells where the value on a display is."
    elif one.reading.type is PointType.UINT16:
        yield "To be asked: perhaps it is a part of a longer number with the register beside it."


def _percent(one: Judged) -> str:
    return f"{min(round(100 * one.likelihood), 99)} % likely"
