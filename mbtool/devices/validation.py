"""What must hold between the keys of a profile."""

# loading.py sees to each key alone. Here: areas that end before they begin or overlap, limits that
# no frame could carry, points outside every area or on top of one another. What a point says of
# itself is validated in validation_of_points.py.

from __future__ import annotations

import re
from typing import TYPE_CHECKING, NoReturn

from mbtool.core.errors import ProfileError, UsageError
from mbtool.core.silence import Silence
from mbtool.devices.model import Access, Area, Point, Profile
from mbtool.devices.validation_of_characters import validate_characters
from mbtool.devices.validation_of_points import Accused, validate_point
from mbtool.modbus.adu import Transport
from mbtool.modbus.functions import FUNCTIONS, WRITE_LIMIT_17H, function_name

if TYPE_CHECKING:
    from mbtool.modbus.tables import Table

_MAX_CODE = 0xFF
_READ_WRITE = 0x17
_MAX_SPANS = 5
_BAUDS = (110, 4_000_000)
"""The slowest and the fastest line: what is too long on both is too long on all."""
_CHARACTER_BITS = 11
_OCTETS = re.compile(r"([0-9A-Fa-f]{2})+")
_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]*")


def validate(profile: Profile, file: str) -> None:
    """Raise ProfileError for the first thing that cannot be."""
    validate_characters(profile, file)
    if _NAME.fullmatch(profile.name) is None:
        raise ProfileError(
            file, "name", f"{profile.name!r}: letters, digits, '-', '_' and '.' make a name"
        )
    prefix = profile.finding_prefix
    if prefix is not None and _NAME.fullmatch(prefix) is None:
        raise ProfileError(
            file,
            "finding_prefix",
            f"{prefix!r}: letters, digits, '-', '_' and '.' make a prefix, as FA3 in FA3-Q16",
        )
    if not profile.transports:
        raise ProfileError(file, "transports", "is empty; name rtu, ascii or tcp")
    _validate_areas(profile, file)
    _validate_functions(profile, file)
    _validate_exceptions(profile, file)
    _validate_timing(profile, file)
    _validate_points(profile, file)


def _validate_areas(profile: Profile, file: str) -> None:
    before: list[Area] = []
    names: set[str] = set()
    for area in sorted(profile.areas, key=lambda area: area.first):
        accused = Accused(file, f'areas "{area.name}"')
        if area.name in names:
            accused.wrong("name", "another area has this name; give it one of its own")
        names.add(area.name)
        if area.last < area.first:
            accused.wrong(
                "last", f"{_address(area.last)} ends before it begins, at {_address(area.first)}"
            )
        if area.access is not Access.READ and not area.table.is_writable:
            accused.wrong("access", f"no function writes {area.table}; 'r' would be right")
        if area.base + area.first < 0:
            accused.wrong(
                "base",
                f"{area.base} gives its first address, {area.first}, the number "
                f"{area.base + area.first}; {-area.first} or more would be right",
            )
        for other in before:
            if _collide(area, other):
                accused.wrong(
                    "first",
                    f'{_address(area.first)} lies in area "{other.name}" of the same table, which '
                    f"ends at {_address(other.last)}; only an 'r' and a 'w' area may overlap",
                )
        before.append(area)


def _collide(area: Area, other: Area) -> bool:
    # One is read and the other written: two meanings of one address, both beyond doubt.
    apart = {area.access, other.access} == {Access.READ, Access.WRITE}
    overlap = area.first <= other.last and other.first <= area.last
    return area.table is other.table and overlap and not apart


def _validate_functions(profile: Profile, file: str) -> None:
    for digits, rule in profile.functions.items():
        code = int(digits, 16)
        accused = Accused(file, f"functions.{digits}")
        known = FUNCTIONS.get(code)
        standard = known.limit if known is not None and known.table is not None else None
        for name in ("limit", "ascii_limit"):
            limit = getattr(rule, name)
            if limit is None:
                continue
            decimal = _meant_in_decimal(profile, digits, limit)
            if standard is None and decimal:
                accused.wrong(name, f"the standard has none for {function_name(code)}{decimal}")
            if standard is not None and limit > standard:
                accused.wrong(
                    name,
                    f"{limit} is more than the {standard} that the standard allows for "
                    f"{function_name(code)}{decimal}",
                )
        if rule.data is not None and _OCTETS.fullmatch(rule.data) is None:
            accused.wrong(
                "data", f"{rule.data!r}: two hexadecimal digits for each byte, like '0000'"
            )
        if rule.write_limit is not None and code != _READ_WRITE:
            accused.wrong(
                "write_limit", "only function 17 both reads and writes; 'limit' would be right"
            )
        if rule.write_limit is not None and rule.write_limit > WRITE_LIMIT_17H:
            accused.wrong(
                "write_limit",
                f"{rule.write_limit} is more than the {WRITE_LIMIT_17H} that the standard allows "
                "function 17 to write",
            )
        if rule.ascii_limit is not None and Transport.ASCII not in profile.transports:
            accused.wrong(
                "ascii_limit", "the device is on no ASCII line; add 'ascii' to the transports"
            )
        if rule.answer is not None and not rule.answers:
            accused.wrong("answers", "false, but 'answer' says what it answers; leave one out")


def _meant_in_decimal(profile: Profile, digits: str, limit: int) -> str:
    """What to add where a key, read as a decimal number, is a function that can have the limit."""
    code = int(digits) if digits.isdecimal() else 0
    known = FUNCTIONS.get(code)
    if known is None or known.table is None or limit > known.limit or profile.rule(code):
        return ""
    return f"; keys are hexadecimal, and {function_name(code)}, function {code}, is {code:02X}"


def _validate_exceptions(profile: Profile, file: str) -> None:
    codes = profile.exceptions
    documented = ", ".join(map(str, codes.documented)) or "there are none"
    for key in ("function", "address", "value"):
        code = getattr(codes, key)
        if code not in codes.documented:
            raise ProfileError(
                file,
                f"exceptions.{key}",
                f"{code} is not among the documented codes ({documented}); add it there, or give "
                "another",
            )
    for code in codes.texts:
        if not 1 <= code <= _MAX_CODE:
            raise ProfileError(file, "exceptions.texts", f"{code} is no code; 1 to 255 are")
        if code not in codes.documented:
            raise ProfileError(
                file,
                "exceptions.texts",
                f"{code} (0x{code:02X}) is not among the documented codes ({documented}); add it "
                "there",
            )


def _validate_timing(profile: Profile, file: str) -> None:
    silences: dict[str, Silence] = {}
    for key in ("t1_5", "t3_5", "request_interval"):
        text = getattr(profile.timing, key)
        try:
            if text is not None:
                silences[key] = Silence.parse(text)
        except UsageError as error:
            raise ProfileError(file, f"timing.{key}", str(error)) from None
    inside, between = silences.get("t1_5"), silences.get("t3_5")
    if inside is None or between is None:
        return
    if all(inside.ns(baud, _CHARACTER_BITS) > between.ns(baud, _CHARACTER_BITS) for baud in _BAUDS):
        raise ProfileError(
            file,
            "timing.t1_5",
            f"{inside} inside a frame is longer than t3_5, {between}, which ends it",
        )


def _validate_points(profile: Profile, file: str) -> None:
    names: set[str] = set()
    taken: dict[tuple[Table, int | None, int, bool], str] = {}
    for point in profile.points:
        accused = Accused(file, f'points "{point.name}"')
        validate_point(point, accused)
        if point.name in names:
            accused.wrong("name", "another point has this name; give it one of its own")
        names.add(point.name)
        if point.block is not None and point.block > point.address:
            accused.wrong(
                "block",
                f"{_address(point.block)} is behind the point itself, at {_address(point.address)}",
            )
        for address in point.addresses:
            access = _access(profile, point, address, accused)
            for word in range(address, address + point.words):
                for writing in (False, True):
                    if not access.allows(writing=writing):
                        continue
                    place = (point.table, point.block, word, writing)
                    other = taken.setdefault(place, point.name)
                    if other != point.name:
                        accused.wrong(
                            "address", f'{point.table} {_address(word)} is "{other}" already'
                        )


def _access(profile: Profile, point: Point, address: int, accused: Accused) -> Access:
    """What a master may do with a point."""
    areas = [area for area in profile.areas if area.holds(point.table, address, point.words)]
    if not areas:
        there = [area for area in profile.areas if area.table is point.table]
        _wrong_address(point, address, there, accused)
    if point.access is None:
        if len(areas) > 1:
            accused.wrong(
                "access",
                f"this key is missing; {point.table} {_address(address)} is read in one area and "
                "written in another: write 'r' or 'w'",
            )
        return areas[0].access
    if len(areas) == 1 and areas[0].access not in (Access.READ_WRITE, point.access):
        accused.wrong(
            "access",
            f"'{point.access}' is not what its area \"{areas[0].name}\" allows: "
            f"'{areas[0].access}'",
        )
    return point.access


def _wrong_address(point: Point, address: int, there: list[Area], accused: Accused) -> NoReturn:
    last = address + point.words - 1
    where = _address(address) if last == address else f"{address}..{last}"
    verb = "is in no area" if last == address else "are not in one area"
    spans = [f"{area.first}..{area.last}" for area in there[:_MAX_SPANS]]
    spans += ["..."] if len(there) > _MAX_SPANS else []
    have = f"there are {', '.join(spans)}" if spans else "there is none of that table"
    accused.wrong("address", f"{point.table} {where} {verb}; {have}")


def _address(address: int) -> str:
    return f"{address} (0x{address:04X})"
