"""Checks that the keys of a profile do not contradict one another or the standard."""

# Examples of mistakes: areas that end before they begin, or overlap; limits above the standard's;
# points outside every area, or two points at one address. loading.py checks each key by itself, and
# below the keys of each point.

from __future__ import annotations

import math
import re
import unicodedata
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any, NoReturn

import msgspec

from mbtool.core.errors import ProfileError, UsageError
from mbtool.core.serial_format import Silence
from mbtool.devices.model import WORD_BITS, Access, Area, FunctionRule, Point, Profile
from mbtool.devices.point_types import PointType, WordOrder
from mbtool.devices.values import PointInstance
from mbtool.modbus.adu import Transport
from mbtool.modbus.functions import FUNCTIONS, READ_WRITE_REGISTERS, WRITE_LIMIT_17H, function_name

if TYPE_CHECKING:
    from mbtool.modbus.tables import Table

# The code below checks that no text of a profile has control characters.
#
# Texts of a profile are printed in tables, in lines of a log and in finding codes. A line end would
# break the table or the line, and a terminal would execute an escape sequence. Only the keys `note`
# and `notes` may have line ends and tabs.

_REFUSED = frozenset(("Cc", "Cs", "Zl", "Zp"))
"""The Unicode categories that texts must not contain: control characters, surrogates, line and
paragraph separators."""
_NOTES = ("notes", "note")
_ALLOWED_IN_NOTES = "\n\r\t"


def validate_characters(profile: Profile, file: str) -> None:
    """Raise ProfileError for the first text of a profile that has a control character; a note may
    have line ends and tabs.

    `file` is the name of the profile's file, for the message.
    """
    for key, text in _texts("", profile):
        allowed = _ALLOWED_IN_NOTES if key.rpartition(".")[2] in _NOTES else ""
        for one in text:
            if unicodedata.category(one) in _REFUSED and one not in allowed:
                raise ProfileError(
                    file, key, f"{text!r} has a control character, {one!r}; leave it out"
                )


def _texts(key: str, value: Any) -> Iterator[tuple[str, str]]:
    """Yield each text in `value` that has unprintable characters, with its key.

    `value` is the value of the key `key`: a profile, a part of one, a list, a dictionary or a text.
    """
    if isinstance(value, str):
        if not value.isprintable():
            yield key, value
    elif isinstance(value, msgspec.Struct):
        for name in value.__struct_fields__:
            yield from _texts(f"{key}.{name}" if key else name, getattr(value, name))
    elif isinstance(value, dict):
        for name, one in value.items():
            yield from _texts(f"{key}.{name}", one)
    elif isinstance(value, list):
        for one in value:
            named = isinstance(one, Area | Point)
            yield from _texts(f"{key} {_quoted(one.name)}" if named else key, one)


def _quoted(name: str) -> str:
    return f'"{"".join(one if one.isprintable() else "?" for one in name)}"'


# The code below checks that the keys of one point of a profile do not contradict one another.

_WITHOUT_NUMBER = (PointType.BIT, PointType.STRING, PointType.FLOAT32, PointType.FLOAT64)
_PLACEHOLDER = re.compile(r"\{(n|reference)\}")


class PartErrors:
    """Raises ProfileError for wrong keys of one part of a profile, such as one point.

    `file` and `key` name the profile's file and the part, for messages.
    """

    def __init__(self, file: str, key: str) -> None:
        self._file = file
        self._key = key

    def wrong(self, key: str, problem: str) -> NoReturn:
        raise ProfileError(self._file, f"{self._key}.{key}", problem)


def validate_point(point: Point, errors: PartErrors) -> None:
    """Check that the keys of a point fit together. Does not compare them with the areas of the
    profile.

    Raises ProfileError for the first mistake.
    """
    if point.table.is_bits != (point.type is PointType.BIT):
        right = "bit" if point.table.is_bits else "a type of registers like uint16"
        errors.wrong("type", f"{point.type} does not fit {point.table}; {right} would be right")
    if not point.name.strip():
        errors.wrong("name", "is empty; a point is found and shown by its name")
    _validate_length(point, errors)
    if point.count > 1 and point.stride < point.words:
        errors.wrong(
            "stride", f"{point.stride} is less than the {point.words} addresses that each takes"
        )
    if point.count == 1:
        for key in ("stride", "counted_from"):
            if getattr(point, key) != 1:
                errors.wrong(key, "there is only one such point; 'count' says how many there are")
        if "{n}" in point.name:
            errors.wrong("name", "{n} counts several points; 'count' says how many there are")
    if "{" in _PLACEHOLDER.sub("", point.name):
        errors.wrong("name", "only {n} and {reference} are filled in")
    if point.count > 1 and _PLACEHOLDER.search(point.name) is None:
        errors.wrong("name", f"{point.count} points need {{n}} or {{reference}} in their name")
    if point.words == 1 and point.word_order is WordOrder.LOW_FIRST:
        errors.wrong("word_order", f"{point.type} has one register; 'byte_order' swaps its bytes")
    _validate_scale(point, errors)
    _validate_joined(point, errors)
    _validate_no_value(point, errors)
    _validate_channels(point, errors)
    _validate_bits(point, errors)
    _validate_texts(point, errors)
    _validate_range(point, errors)


def _validate_length(point: Point, errors: PartErrors) -> None:
    if point.type is not PointType.STRING:
        if point.length is not None:
            errors.wrong("length", f"only a string has a length, not {point.type}")
        return
    if point.length is None:
        errors.wrong("length", "this key is missing; it says how many registers the string takes")
    if point.word_order is WordOrder.LOW_FIRST:
        errors.wrong(
            "word_order", "the registers of a string stand in order; swap bytes by 'byte_order'"
        )


def _validate_scale(point: Point, errors: PartErrors) -> None:
    if not math.isfinite(point.scale) or point.scale == 0:
        errors.wrong("scale", f"{point.scale:g} scales nothing; 0.1 would be right for tenths")
    if not math.isfinite(point.offset):
        errors.wrong("offset", f"{point.offset} is no number to add; -50 would be one")
    if point.type.is_number:
        return
    for key, neutral in (("scale", 1), ("scale_from", None), ("offset", 0), ("decimals", None)):
        if getattr(point, key) != neutral:
            errors.wrong(key, f"only numbers have it, for example int16, not {point.type}")


def _validate_no_value(point: Point, errors: PartErrors) -> None:
    if point.no_value is None:
        return
    allowed = point.type.whole_numbers or range(1 << WORD_BITS)
    if point.type in _WITHOUT_NUMBER:
        errors.wrong("no_value", f"only whole numbers have it, for example int16, not {point.type}")
    if point.no_value not in allowed:
        errors.wrong(
            "no_value",
            f"{point.no_value} does not fit {point.type}, which holds {allowed[0]}..{allowed[-1]}",
        )


def _validate_channels(point: Point, errors: PartErrors) -> None:
    bits = point.type.channel_bits
    if point.channels is None:
        return
    if bits == 0:
        errors.wrong("channels", f"only bit-field and nibble-field have channels, not {point.type}")
    if point.channels * bits > WORD_BITS:
        errors.wrong(
            "channels", f"{point.channels} do not fit a register; {WORD_BITS // bits} at most do"
        )


def _validate_joined(point: Point, errors: PartErrors) -> None:
    if (point.units_from is None) == bool(point.units):
        errors.wrong("units", "units_from says where the number is, units what it means: give both")
    if point.units_from is not None and point.type is not PointType.UINT16:
        errors.wrong("units_from", f"only uint16 has it, not {point.type}")
    if point.after is not None and point.type is not PointType.OCTETS:
        errors.wrong("after", f"only octets have it, not {point.type}")


def _validate_bits(point: Point, errors: PartErrors) -> None:
    if point.type is not PointType.FLAGS:
        if point.bits:
            errors.wrong("bits", f"only flags have named bits, not {point.type}")
        return
    if not point.bits:
        errors.wrong("bits", 'this key is missing; name the bits, for example { 0 = "ready" }')
    for bit in point.bits:
        if not 0 <= bit < WORD_BITS:
            errors.wrong("bits", f"a register has no bit {bit}, only 0 to {WORD_BITS - 1}")


def _validate_texts(point: Point, errors: PartErrors) -> None:
    if not point.texts:
        return
    bits = 1 if point.type is PointType.BIT else point.type.channel_bits
    allowed = range(1 << bits) if bits else point.type.whole_numbers
    if point.type is PointType.HEX16:
        allowed = range(1 << WORD_BITS)
    if allowed is None:
        is_flags = point.type is PointType.FLAGS
        advice = "'bits' name them" if is_flags else "only whole numbers have them"
        errors.wrong("texts", f"{point.type} has no texts; {advice}")
    for value in point.texts:
        if value not in allowed:
            each = f"the {bits} bit of each channel" if point.type.channel_bits else point.type
            errors.wrong(
                "texts", f"{value} does not fit {each}, which holds {allowed[0]}..{allowed[-1]}"
            )


def _validate_range(point: Point, errors: PartErrors) -> None:
    low, high = point.minimum, point.maximum
    for key, end in (("minimum", low), ("maximum", high)):
        if end is not None and not math.isfinite(end):
            errors.wrong(key, f"{end} is no limit; leave the key out")
    if low is not None and high is not None and low > high:
        errors.wrong("minimum", f"{low} is more than the maximum, {high}")
    if point.default is None:
        return
    if point.type is PointType.BIT and point.default > 1:
        errors.wrong("default", f"{point.default} is no bit; 0 or 1 would be right")
    if point.words > 1:
        errors.wrong(
            "default", f"only a point of one register has a default, not the {point.words} of this"
        )
    value = PointInstance(point, point.address, "").value([point.default]).value
    if value is None and point.type is PointType.BCD16:
        errors.wrong("default", f"0x{point.default:04X} is no {point.type}")
    if value is None:
        return
    shown = point.default if value == point.default else f"{point.default}, a value of {value},"
    if low is not None and value < low:
        errors.wrong("default", f"{shown} is less than the minimum, {low}")
    if high is not None and value > high:
        errors.wrong("default", f"{shown} is more than the maximum, {high}")


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
    """The areas so far that end behind the beginning of the last one."""
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
        before = [other for other in before if other.last >= area.first]
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
