"""Checks that the keys of a profile do not contradict one another or the standard."""

# Examples of mistakes: areas that end before they begin, or overlap; limits above the standard's;
# points outside every area, or two points at one address. loading.py checks each key by itself, and
# validation_of_points.py the keys of each point.

from __future__ import annotations

import re
from typing import TYPE_CHECKING, NoReturn

from mbtool.core.errors import ProfileError, UsageError
from mbtool.core.serial_format import Silence
from mbtool.devices.model import Access, Area, Point, Profile
from mbtool.devices.point_types import PointType
from mbtool.devices.validation_of_characters import validate_characters
from mbtool.devices.validation_of_points import PartErrors, validate_point
from mbtool.modbus.adu import Transport
from mbtool.modbus.functions import FUNCTIONS, READ_WRITE_REGISTERS, WRITE_LIMIT_17H, function_name

if TYPE_CHECKING:
    from mbtool.devices.model import FunctionRule
    from mbtool.modbus.tables import Table

_MAX_CODE = 0xFF

_MAX_SPANS = 5
_BAUDS = (110, 4_000_000)
"""The lowest and the highest usual baud rate. If the profile's t1.5 is longer than its t3.5 at
both, it is longer at every baud rate."""
_CHARACTER_BITS = 11
_OCTETS = re.compile(r"([0-9A-Fa-f]{2})+")
_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]*")


def validate(profile: Profile, file: str) -> None:
    """Check a profile. Raises ProfileError for the first mistake.

    `file` is the name of the profile's file, for the message.
    """
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
        errors = PartErrors(file, f'areas "{area.name}"')
        if area.name in names:
            errors.wrong("name", "another area has this name; give it one of its own")
        names.add(area.name)
        if area.last < area.first:
            errors.wrong(
                "last", f"{_address(area.last)} ends before it begins, at {_address(area.first)}"
            )
        if area.access is not Access.READ and not area.table.is_writable:
            errors.wrong("access", f"no function writes {area.table}; 'r' would be right")
        if area.base + area.first < 0:
            errors.wrong(
                "base",
                f"{area.base} gives its first address, {area.first}, the number "
                f"{area.base + area.first}; {-area.first} or more would be right",
            )
        for other in before:
            if _collide(area, other):
                errors.wrong(
                    "first",
                    f'{_address(area.first)} lies in area "{other.name}" of the same table, which '
                    f"ends at {_address(other.last)}; only an 'r' and a 'w' area may overlap",
                )
        before.append(area)


def _collide(area: Area, other: Area) -> bool:
    # Two areas may overlap if one can only be read and the other only written: the function of a
    # request then tells which of the two areas it means.
    apart = {area.access, other.access} == {Access.READ, Access.WRITE}
    overlap = area.first <= other.last and other.first <= area.last
    return area.table is other.table and overlap and not apart


def _validate_functions(profile: Profile, file: str) -> None:
    for digits, rule in profile.functions.items():
        code = int(digits, 16)
        errors = PartErrors(file, f"functions.{digits}")
        known = FUNCTIONS.get(code)
        standard = known.limit if known is not None and known.table is not None else None
        for name in ("limit", "ascii_limit"):
            limit = getattr(rule, name)
            if limit is None:
                continue
            decimal = _meant_in_decimal(profile, digits, limit)
            if standard is None and decimal:
                errors.wrong(name, f"the standard has none for {function_name(code)}{decimal}")
            if standard is not None and limit > standard:
                errors.wrong(
                    name,
                    f"{limit} is more than the {standard} that the standard allows for "
                    f"{function_name(code)}{decimal}",
                )
        if rule.data is not None and _OCTETS.fullmatch(rule.data) is None:
            errors.wrong(
                "data", f"{rule.data!r}: two hexadecimal digits for each byte, like '0000'"
            )
        if rule.write_limit is not None and code != READ_WRITE_REGISTERS:
            errors.wrong(
                "write_limit", "only function 17 both reads and writes; 'limit' would be right"
            )
        if rule.write_limit is not None and rule.write_limit > WRITE_LIMIT_17H:
            errors.wrong(
                "write_limit",
                f"{rule.write_limit} is more than the {WRITE_LIMIT_17H} that the standard allows "
                "function 17 to write",
            )
        if rule.ascii_limit is not None and Transport.ASCII not in profile.transports:
            errors.wrong(
                "ascii_limit", "the device is on no ASCII line; add 'ascii' to the transports"
            )
        _validate_codes(profile, rule, code, errors)
        if rule.answer is not None and not rule.answers:
            errors.wrong("answers", "false, but 'answer' says what it answers; leave one out")


def _validate_codes(profile: Profile, rule: FunctionRule, code: int, errors: PartErrors) -> None:
    known, own = profile.exceptions.documented, profile.documented_exceptions(code)
    for each in rule.documented or ():
        if each not in known:
            listed = ", ".join(map(str, known)) or "there are none"
            errors.wrong(
                "documented",
                f"{each} is not among the documented codes of the device ({listed}); add it to "
                "'documented' of [exceptions]",
            )
    if profile.value_exception(code) not in own and (rule.value or rule.documented) is not None:
        listed = ", ".join(map(str, own)) or "there are none"
        errors.wrong(
            "value",
            f"{profile.value_exception(code)} is not among the documented codes of the function "
            f"({listed}); give another",
        )


def _meant_in_decimal(profile: Profile, digits: str, limit: int) -> str:
    """Return a hint for the user who probably wrote a function code in decimal; otherwise an empty
    text.

    There is a hint if `digits`, read as a decimal number, are a function that allows quantities up
    to `limit`, the limit that the user gives the function.
    """
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
        errors = PartErrors(file, f'points "{point.name}"')
        validate_point(point, errors)
        if point.name in names:
            errors.wrong("name", "another point has this name; give it one of its own")
        names.add(point.name)
        if point.block is not None and point.block > point.address:
            errors.wrong(
                "block",
                f"{_address(point.block)} is behind the point itself, at {_address(point.address)}",
            )
        for address in point.addresses:
            access = _access(profile, point, address, errors)
            for word in range(address, address + point.words):
                for writing in (False, True):
                    if not access.allows(writing=writing):
                        continue
                    key = (point.table, point.block, word, writing)
                    other = taken.setdefault(key, point.name)
                    if other != point.name:
                        errors.wrong(
                            "address", f'{point.table} {_address(word)} is "{other}" already'
                        )
    _validate_scale_points(profile, file)


def _validate_scale_points(profile: Profile, file: str) -> None:
    """Check that each key `scale_from` names a point of a single register whose number is not
    scaled.
    """
    named = {point.name: point for point in profile.points}
    for point in profile.points:
        if point.scale_from is None:
            continue
        errors = PartErrors(file, f'points "{point.name}"')
        scale = named.get(point.scale_from)
        if scale is None:
            errors.wrong("scale_from", f"there is no point {point.scale_from!r}")
        if scale.type not in (PointType.INT16, PointType.UINT16) or scale.count > 1:
            errors.wrong("scale_from", f"{scale.name!r} is not one point of type int16 or uint16")
        if (scale.scale, scale.offset, scale.scale_from, scale.block) != (1, 0, None, None):
            errors.wrong("scale_from", f"{scale.name!r} has a scale, an offset or a block itself")


def _access(profile: Profile, point: Point, address: int, errors: PartErrors) -> Access:
    """Return the access that a master has to the value of a point at `address`: the point's key
    `access`, or else that of its area.

    Raises ProfileError if this value is in no area, or if the area does not allow the point's
    access.
    """
    areas = [area for area in profile.areas if area.holds(point.table, address, point.words)]
    if not areas:
        of_table = [area for area in profile.areas if area.table is point.table]
        _wrong_address(point, address, of_table, errors)
    if point.access is None:
        if len(areas) > 1:
            errors.wrong(
                "access",
                f"this key is missing; {point.table} {_address(address)} is read in one area and "
                "written in another: write 'r' or 'w'",
            )
        return areas[0].access
    if len(areas) == 1 and areas[0].access not in (Access.READ_WRITE, point.access):
        errors.wrong(
            "access",
            f"'{point.access}' is not what its area \"{areas[0].name}\" allows: "
            f"'{areas[0].access}'",
        )
    return point.access


def _wrong_address(point: Point, address: int, areas: list[Area], errors: PartErrors) -> NoReturn:
    last = address + point.words - 1
    where = _address(address) if last == address else f"{address}..{last}"
    verb = "is in no area" if last == address else "are not in one area"
    spans = [f"{area.first}..{area.last}" for area in areas[:_MAX_SPANS]]
    spans += ["..."] if len(areas) > _MAX_SPANS else []
    have = f"there are {', '.join(spans)}" if spans else "there is none of that table"
    errors.wrong("address", f"{point.table} {where} {verb}; {have}")


def _address(address: int) -> str:
    return f"{address} (0x{address:04X})"
