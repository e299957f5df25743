"""Makes the draft of a profile from what was seen of a slave."""

# What the slave answered is taken as a fact: the addresses it gave or took, the functions, and the
# exceptions. What it refused with exception 01 is no function of it, and what it refused with 02 or
# 03 no address. What it never answered is unknown, and stands in the draft with a comment that says
# so. How registers belong together is guessed (guesses.py), with the reason as a comment.
#
# Limits: MAX_POINTS points; of how many registers there are more is said.

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from pathlib import PurePath
from typing import TYPE_CHECKING

import msgspec

from mbtool.core.wording import counted
from mbtool.devices.drafting.guesses import Guess, guess_registers
from mbtool.devices.dumping import dump_profile
from mbtool.devices.model import (
    Access,
    Area,
    Exceptions,
    FunctionRule,
    Point,
    PointType,
    Profile,
    WordOrder,
)
from mbtool.devices.references import write_reference
from mbtool.devices.validation import validate
from mbtool.modbus.functions import FUNCTIONS, ExceptionCode, exception_name, function_name
from mbtool.modbus.tables import Table

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from mbtool.devices.observed_slave import ObservedRequest, ObservedSlave, Replies

MAX_POINTS = 1000
MAX_LISTED = 24

_NO_FUNCTION = ExceptionCode.ILLEGAL_FUNCTION
_WRONG_VALUE = ExceptionCode.ILLEGAL_DATA_VALUE
_REFUSALS = frozenset((_NO_FUNCTION, ExceptionCode.ILLEGAL_DATA_ADDRESS, _WRONG_VALUE))
_PREFIXES = {
    Table.COILS: "C",
    Table.DISCRETE_INPUTS: "DI",
    Table.HOLDING_REGISTERS: "HR",
    Table.INPUT_REGISTERS: "IR",
}
"""How a draft writes addresses, as they are on the wire."""

_READ, _WRITTEN, _UNKNOWN = 1, 2, 4


@dataclass(frozen=True, slots=True)
class Draft:
    """A profile and its text."""

    profile: Profile
    text: str


def draft_profile(seen: ObservedSlave, name: str, file: str) -> Draft:
    """Draft a profile of the slave; `file` is where it was seen. Any traffic gives one."""
    file = PurePath(file).name
    maps = _maps(seen)
    comments: dict[str, list[str]] = {}
    areas = [area for table in Table for area in _areas(table, maps[table], seen, comments)]
    functions, said = _functions(seen)
    comments["functions"] = said
    profile = Profile(
        name=name,
        title=_title(seen),
        vendor=seen.identity.get("vendor") or "unknown",
        transports=sorted(seen.transports),
        source=f"traffic of {_who(seen)} in {file}",
        areas=areas,
        functions=functions,
        exceptions=Exceptions(documented=sorted({*map(int, _REFUSALS), *_exceptions(seen)})),
    )
    points, left_out = _points(profile, seen, comments)
    profile = msgspec.structs.replace(profile, points=points)
    comments[""] = _head(seen, file, left_out)
    validate(profile, name)
    return Draft(profile, dump_profile(profile, comments))


def _title(seen: ObservedSlave) -> str:
    names = ("product", "model", "product code")
    return next((seen.identity[one] for one in names if seen.identity.get(one)), _who(seen))


def _who(seen: ObservedSlave) -> str:
    at = f" at {seen.who.host}" if seen.who.host is not None else ""
    return f"unit {seen.unit}{at}"


def _head(seen: ObservedSlave, file: str, left_out: int) -> list[str]:
    head = [
        f"Drafted by mbtool from what {_who(seen)} was asked and answered in {file}, "
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


def _maps(seen: ObservedSlave) -> dict[Table, bytearray]:
    """What is known of each address."""
    maps = {table: bytearray(1 << 16) for table in Table}
    for ask, replies in seen.asked.items():
        if ask.table is None or ask.address is None:
            continue
        flag = 0
        if replies.ok:
            flag = _WRITTEN if ask.writes else _READ
        elif _REFUSALS.isdisjoint(replies.exceptions):
            flag = _UNKNOWN | (_WRITTEN if ask.writes else _READ)
        here = maps[ask.table]
        for address in ask.span if flag else ():
            here[address] = _joined(here[address], flag)
    return maps


def _joined(known: int, flag: int) -> int:
    """An answer anywhere says more than a silence."""
    if not known or (known & _UNKNOWN and not flag & _UNKNOWN):
        rights = known | flag
        return rights if flag & _UNKNOWN else rights & ~_UNKNOWN
    return known | flag & ~_UNKNOWN


def _areas(
    table: Table, known: bytearray, seen: ObservedSlave, comments: dict[str, list[str]]
) -> Iterator[Area]:
    refused = [
        (ask, replies)
        for ask, replies in seen.asked.items()
        if ask.table is table and not replies.ok and replies.exceptions
    ]
    for first, last in _runs(known):
        rights = known[first : last + 1]
        written = any(flag & _WRITTEN for flag in rights)
        prefix = _PREFIXES[table]
        area = Area(
            name=f"{prefix}{first}..{last}" if last > first else f"{prefix}{first}",
            table=table,
            first=first,
            last=last,
            access=Access.READ_WRITE if written else Access.READ,
            prefix=prefix,
        )
        comments[f'areas "{area.name}"'] = list(_about_area(area, rights, refused))
        yield area


def _runs(known: bytearray) -> Iterator[tuple[int, int]]:
    """The ranges of addresses of which something is known; silence apart from answers."""
    start = None
    kind = 0
    for address, flag in enumerate([*known, 0]):
        now = 0 if not flag else 2 if flag & _UNKNOWN else 1
        if now != kind:
            if start is not None:
                yield start, address - 1
            start, kind = (address if now else None), now


def _about_area(
    area: Area, rights: bytearray, refused: Sequence[tuple[ObservedRequest, Replies]]
) -> Iterator[str]:
    if rights[0] & _UNKNOWN:
        yield "Asked for, but never answered: perhaps there is nothing here."
    if area.access is Access.READ and area.table.is_writable:
        yield "Nobody wrote here; if the device allows it, access is rw."
    elif area.access is Access.READ_WRITE:
        places = _folded([area.first + at for at, flag in enumerate(rights) if flag & _WRITTEN])
        yield f"Written here: {places}."
        if not any(flag & _READ for flag in rights):
            yield "Never read here."
    near = [
        f"{write_reference(None, area.table, ask.address or 0, ask.quantity)} "
        f"(exception {next(iter(replies.exceptions)):02X})"
        for ask, replies in refused
        if ask.span.start <= area.last + 1 and ask.span.stop >= area.first
    ]
    if near:
        yield f"Refused beside it: {', '.join(near[:MAX_LISTED])}."


def _folded(addresses: Sequence[int]) -> str:
    """Ranges with both ends: 1, 3..5, 8."""
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
    """What was seen of one function."""

    ok: int = 0
    silent: int = 0
    most: int = 0
    refused: Counter[int] = field(default_factory=Counter)
    least_refused: int = 1 << 16
    """The least quantity that was refused as a wrong value though its addresses are there."""


def _functions(seen: ObservedSlave) -> tuple[dict[str, FunctionRule], list[str]]:
    """A rule for each function that the slave may have, and a sentence on each that was asked."""
    rules: dict[str, FunctionRule] = {}
    said: list[str] = []
    for code, one in sorted(_found(seen).items()):
        phrases = list(_about_function(code, one))
        if not one.ok and _NO_FUNCTION in one.refused:
            phrases.append("so not listed")
        else:
            limit = _limit(code, one)
            if limit is not None:
                phrases.append(f"{one.least_refused} are refused, so {limit} is taken as its limit")
            rules[f"{code:02X}"] = FunctionRule(limit=limit)
        said.append(", ".join(phrases))
    return rules, said


def _found(seen: ObservedSlave) -> dict[int, _Function]:
    found: dict[int, _Function] = {}
    for ask, replies in seen.asked.items():
        one = found.setdefault(ask.function, _Function())
        one.ok += replies.ok
        one.silent += replies.silent
        one.refused += replies.exceptions
        if replies.ok:
            one.most = max(one.most, ask.quantity)
    given = seen.given()
    for ask, replies in seen.asked.items():
        if ask.table is None or replies.ok or _WRONG_VALUE not in replies.exceptions:
            continue
        if all(given[ask.table][ask.span.start : ask.span.stop]):
            one = found[ask.function]
            one.least_refused = min(one.least_refused, ask.quantity)
    return found


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
    """The largest quantity, where one was refused that is only too large."""
    known = FUNCTIONS.get(code)
    if known is None or not 0 < one.most < one.least_refused < known.limit:
        return None
    return one.most


def _exceptions(seen: ObservedSlave) -> set[int]:
    return {code for one in seen.asked.values() for code in one.exceptions if 1 <= code <= 0xFF}


def _points(
    profile: Profile, seen: ObservedSlave, comments: dict[str, list[str]]
) -> tuple[list[Point], int]:
    """Points for the registers whose values were seen, and how many registers had no room."""
    points: list[Point] = []
    left_out = 0
    for table in (Table.HOLDING_REGISTERS, Table.INPUT_REGISTERS):
        taken: set[int] = set()
        # The widest requests show best how registers belong together, and reads better than writes.
        asks = sorted(
            (ask for ask in seen.samples if ask.table is table),
            key=lambda ask: (ask.writes, -ask.quantity, ask.address or 0),
        )
        twos = {ask.address for ask in asks if ask.quantity == 2 and ask.address is not None}
        guesses: list[Guess] = []
        for ask in asks:
            times = "writes" if ask.writes else "answers"
            for guess in guess_registers(ask.span.start, seen.samples[ask], twos, times):
                places = range(guess.address, guess.address + guess.words)
                if taken.isdisjoint(places) and profile.area(table, guess.address, guess.words):
                    taken.update(places)
                    guesses.append(guess)
        guesses.sort(key=lambda guess: guess.address)
        for guess in guesses:
            if len(points) >= MAX_POINTS:
                left_out += guess.words
                continue
            point = _point(table, guess)
            is_plain = guess.type is PointType.UINT16
            comments[f'points "{point.name}"'] = [
                f"{'Seen' if is_plain else 'A guess'}: {guess.reason}."
            ]
            points.append(point)
    return points, left_out


def _point(table: Table, guess: Guess) -> Point:
    return Point(
        name=f"{_PREFIXES[table]}{guess.address}",
        table=table,
        address=guess.address,
        type=guess.type,
        length=guess.length,
        word_order=guess.word_order if guess.type is not PointType.STRING else WordOrder.HIGH_FIRST,
    )
