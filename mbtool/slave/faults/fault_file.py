"""Reads the faults that a slave is to simulate from a TOML file."""

# The file has a seed and a [[faults]] table for each fault:
#
#     seed = 7
#
#     [[faults]]
#     kind = "exception"                     # a FaultKind; _TAKES lists the keys of each kind
#     code = 6
#     functions = [3, 0x10]                  # the keys from here on say which requests the fault is
#                                            # for; a request must fit all of them
#     units = [1]
#     registers = "HR400001..400010"         # or 'holding 0..9'
#     seconds = [10, 20]                     # from and until, counted from the first request
#     nth = 3                                # the third request that fits
#     every = 5                              # and every fifth from there on
#     times = 2                              # at most twice
#     probability = 0.5
#
# Limits: a file of at most 1 MiB.

from __future__ import annotations

import difflib
import reprlib
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, NoReturn

from mbtool.core import UsageError
from mbtool.core.moments import SECOND_NS
from mbtool.devices import Profile, parse_span
from mbtool.devices.loading import read_toml
from mbtool.modbus.adu import MAX_TCP_ADU
from mbtool.slave.faults.faults import Fault, FaultCondition, FaultKind

MAX_FILE_BYTES = 1 << 20
MAX_EXTRA_BYTES = 1024
MAX_SECONDS = 86_400

_MATCHING = ("units", "functions", "registers", "seconds", "nth", "every", "times", "probability")
_TAKES = {
    FaultKind.DELAY: ("ms",),
    FaultKind.EXCEPTION: ("code",),
    FaultKind.WRONG_UNIT: ("by",),
    FaultKind.WRONG_ID: ("by",),
    FaultKind.TRUNCATED: ("bytes",),
    FaultKind.EXTRA_BYTES: ("bytes",),
    FaultKind.SPLIT: ("pieces", "gap_ms"),
    FaultKind.OFFSET: ("by",),
}
_ADDED = {FaultKind.WRONG_UNIT: (1, 0xFF), FaultKind.WRONG_ID: (1, 0xFFFF)}
"""The least and greatest number that the key `by` may have, for the two kinds of fault that need
a limit: adding any of these to a unit, or to a transaction id, gives a different one."""
_DEFAULT_GAP_MS = 20
_MS = 1_000_000


class FaultFile:
    """The faults in one file, and the seed of their random generators."""

    def __init__(self, source: Path | Mapping[str, Any], profiles: Iterable[Profile] = ()) -> None:
        """Read the TOML file `source`; a mapping is taken as the keys and values of such a file.

        `profiles` are those of the slaves; they give references such as HR400001 their addresses.
        Raises InputError for a file that cannot be read, UsageError for one that is no TOML or has
        a wrong key or value.
        """
        if isinstance(source, Path):
            path = str(source)
            keys = read_toml(source, MAX_FILE_BYTES, "list of faults", "see docs/faults.md")
        else:
            path, keys = "faults", dict(source)
        whole = _Table(path, keys)
        self.seed = whole.number("seed", 0, -(1 << 63), 1 << 63)
        tables = keys.pop("faults", [])
        whole.demand_only(("seed", "faults"))
        if not isinstance(tables, list) or not tables:
            raise UsageError(f"{path}: no [[faults]]; write one for each fault")
        self.faults = [
            _fault(_Table(f"{path}: fault {number}", table), list(profiles))
            for number, table in enumerate(tables, start=1)
        ]


def _fault(table: _Table, profiles: list[Profile]) -> Fault:
    kind = table.choice("kind", FaultKind)
    takes = _TAKES.get(kind, ())
    table.demand_only(("kind", *takes, *_MATCHING))
    match = _match(table, profiles)
    least, greatest = _ADDED.get(kind, (-0xFFFF, 0xFFFF))
    if kind is FaultKind.EXTRA_BYTES:
        return Fault(kind=kind, match=match, extra=table.hexadecimal("bytes"))
    if kind is FaultKind.SPLIT:
        gap_ns = round(table.real("gap_ms", _DEFAULT_GAP_MS, 0, MAX_SECONDS * 1000) * _MS)
        count = table.number("pieces", 2, 2, MAX_TCP_ADU)
        return Fault(kind=kind, match=match, count=count, delay_ns=gap_ns)
    return Fault(
        kind=kind,
        match=match,
        delay_ns=round(table.real("ms", None, 0, MAX_SECONDS * 1000) * _MS) if "ms" in takes else 0,
        code=table.number("code", 4, 1, 0xFF),
        by=table.number("by", 1, least, greatest),
        count=table.number("bytes", 1, 1, 520),
    )


def _match(table: _Table, profiles: list[Profile]) -> FaultCondition:
    begin, end = table.seconds()
    registers = table.text("registers")
    try:
        span = parse_span(registers, profiles) if registers is not None else None
    except UsageError as error:
        table.wrong("registers", str(error))
    return FaultCondition(
        units=table.numbers("units", 0, 0xFF),
        functions=table.numbers("functions", 1, 0x7F),
        span=span,
        from_ns=round(begin * SECOND_NS),
        until_ns=round(end * SECOND_NS) if end is not None else None,
        nth=table.number("nth", 1, 1, 1 << 31),
        every=table.number("every", 1, 1, 1 << 31),
        times=table.number("times", 1, 1, 1 << 31) if table.has("times") else None,
        probability=table.real("probability", 1, 0, 1),
    )


class _Table:
    """Reads the keys of one TOML table of the file; an error message names the table."""

    def __init__(self, where: str, keys: object) -> None:
        if not isinstance(keys, dict):
            raise UsageError(f"{where}: write [[faults]] above the keys of each fault")
        self._where = where
        self._keys: dict[str, Any] = keys

    def has(self, key: str) -> bool:
        return key in self._keys

    def wrong(self, key: str, problem: str) -> NoReturn:
        raise UsageError(f"{self._where}: {key}: {problem}")

    def demand_only(self, known: tuple[str, ...]) -> None:
        for key in self._keys:
            if key not in known:
                near = difflib.get_close_matches(key, known, n=1)
                hint = f"did you mean {near[0]}?" if near else f"there is {', '.join(known)}"
                self.wrong(key, f"not a key that belongs here; {hint}")

    def choice(self, key: str, kinds: type[FaultKind]) -> FaultKind:
        value = self._keys.get(key)
        try:
            return kinds(str(value))
        except ValueError:
            said = "is missing" if value is None else f"{reprlib.repr(value)} is none"
            self.wrong(key, f"{said}; write one of {', '.join(kinds)}")

    def text(self, key: str) -> str | None:
        value = self._keys.get(key)
        if value is not None and not isinstance(value, str):
            self.wrong(key, f"{reprlib.repr(value)}: write a text")
        return value

    def number(self, key: str, default: int, least: int, greatest: int) -> int:
        value = self._keys.get(key, default)
        if not _is_number(value) or not isinstance(value, int) or not least <= value <= greatest:
            self.wrong(key, f"{reprlib.repr(value)}: write a number from {least} to {greatest}")
        return value

    def real(self, key: str, default: float | None, least: float, greatest: float) -> float:
        value = self._keys.get(key, default)
        if value is None:
            self.wrong(key, f"is missing; write a number from {least} to {greatest}")
        if not _is_number(value) or not least <= value <= greatest:
            self.wrong(key, f"{reprlib.repr(value)}: write a number from {least} to {greatest}")
        return float(value)

    def numbers(self, key: str, least: int, greatest: int) -> frozenset[int] | None:
        values = self._keys.get(key)
        if values is None:
            return None
        listed = values if isinstance(values, list) else [values]
        good = [one for one in listed if _is_number(one) and isinstance(one, int)]
        if not listed or good != listed or not least <= min(good) <= max(good) <= greatest:
            self.wrong(key, f"{reprlib.repr(values)}: list numbers from {least} to {greatest}")
        return frozenset(good)

    def seconds(self) -> tuple[float, float | None]:
        pair = self._keys.get("seconds")
        if pair is None:
            return 0.0, None
        if (
            not isinstance(pair, list)
            or len(pair) != 2
            or not all(_is_number(one) for one in pair)
            or not 0 <= pair[0] < pair[1] <= MAX_SECONDS
        ):
            self.wrong("seconds", f"{reprlib.repr(pair)}: write from and until, such as [10, 20]")
        return float(pair[0]), float(pair[1])

    def hexadecimal(self, key: str) -> bytes:
        value = self._keys.get(key, "00")
        try:
            data = bytes.fromhex(value) if isinstance(value, str) else b""
        except ValueError:
            data = b""
        if not 0 < len(data) <= MAX_EXTRA_BYTES:
            self.wrong(key, f'{reprlib.repr(value)}: write hexadecimal bytes, such as "00 FF"')
        return data


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)
