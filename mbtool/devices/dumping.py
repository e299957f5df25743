"""Writes a profile as the text of a TOML file."""

# The text contains everything from the profiles that the profile extends; loading it gives an equal
# profile. Keys with default values are left out. A profile has no comments, but the caller can add
# some.
#
# No library writes the TOML, because numbers must be readable: codes are hexadecimal, and addresses
# are, too, if the manual writes them so.

from __future__ import annotations

import functools
import json
import textwrap
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import msgspec

from mbtool.devices.model import Exceptions, Point, Profile, Radix, Timing
from mbtool.devices.point_types import PointType

if TYPE_CHECKING:
    from mbtool.devices.model import Area, FunctionRule, Texts

_WIDTH = 100
_SECTIONS = ("areas", "functions", "exceptions", "timing", "points")
_WRITTEN_IN_HEX = (
    PointType.HEX16,
    PointType.OCTETS,
    PointType.FLAGS,
    PointType.BIT_FIELD,
    PointType.NIBBLE_FIELD,
)


def dump_profile(profile: Profile, comments: Mapping[str, Sequence[str]] | None = None) -> str:
    """Return the TOML text of a profile.

    `comments` has sentences to write as comments before a part of the file; None for no comments.
    Its keys name the parts: "" for the whole file, `functions`, `areas "NAME"` or `points "NAME"`.
    """
    about = comments or {}
    blocks = [
        _lines(_keys(profile, leave_out=_SECTIONS), in_hex=("model_code",)),
        *_functions(profile.functions),
    ]
    if not profile.areas:
        blocks[0] = [*blocks[0], "areas = []"]
    if profile.exceptions != Exceptions():
        blocks.append(["[exceptions]", *_exceptions(profile.exceptions)])
    if profile.timing != Timing():
        blocks.append(["[timing]", *_lines(_keys(profile.timing))])
    if "functions" in about:
        blocks[1] = [*_comment(about["functions"]), *blocks[1]]
    for area in profile.areas:
        comment = _comment(about.get(f'areas "{area.name}"', ()))
        blocks.append([*comment, "[[areas]]", *_area(area)])
    for point in profile.points:
        comment = _comment(about.get(f'points "{point.name}"', ()))
        blocks.append([*comment, "[[points]]", *_point(profile, point)])
    if "" in about:
        blocks.insert(0, _comment(about[""]))
    return "\n\n".join("\n".join(block) for block in blocks) + "\n"


def dump_point(profile: Profile, point: Point, comment: Sequence[str] = ()) -> str:
    """Return the TOML text of one point of a profile, with sentences to write as a comment."""
    return "\n".join([*_comment(comment), "[[points]]", *_point(profile, point)])


def _comment(sentences: Iterable[str]) -> list[str]:
    """Return each sentence as lines of a TOML comment, with ? in place of control characters."""
    lines: list[str] = []
    for sentence in sentences:
        plain = "".join(one if one.isprintable() else "?" for one in sentence)
        lines += textwrap.wrap(
            plain, _WIDTH, initial_indent="# ", subsequent_indent="# ", break_long_words=False
        ) or ["#"]
    return lines


def _functions(functions: Mapping[str, FunctionRule]) -> Iterator[list[str]]:
    """Yield the lines of each TOML table about functions; the keys of `functions` are function
    codes as two hexadecimal digits.

    The first table lists all functions whose rule has no key `answer`. Each rule with an `answer`
    (the meaning of the response of a vendor's own function) gets a table of its own.
    """
    yield [
        "[functions]",
        *(
            f"{code} = {_inline(_keys(rule))}"
            for code, rule in functions.items()
            if rule.answer is None
        ),
    ]
    for code, rule in functions.items():
        if rule.answer is not None:
            own = _lines(_keys(rule, leave_out=("answer",)))
            answer = _keys(rule.answer)
            if rule.answer.texts:
                answer["texts"] = _hex_keys(rule.answer.texts, 4)
            name = f"functions.{code}.answer"
            yield [f"[functions.{code}]", *own, "", f"[{name}]", *_lines(answer, within=name)]


def _exceptions(exceptions: Exceptions) -> list[str]:
    keys = _keys(exceptions)
    if exceptions.texts:
        keys["texts"] = _hex_keys(exceptions.texts, 2)
    return _lines(keys, within="exceptions")


def _area(area: Area) -> list[str]:
    return _lines(_keys(area), in_hex=("first", "last") if area.radix is Radix.HEX else ())


def _point(profile: Profile, point: Point) -> list[str]:
    area = profile.area(point.table, point.address, point.words)
    in_hex = ["address", "block"] if area is not None and area.radix is Radix.HEX else []
    keys = _keys(point)
    if point.type in _WRITTEN_IN_HEX:
        in_hex.append("default")
    if point.type is PointType.HEX16 and point.texts:
        keys["texts"] = _hex_keys(point.texts, 4)
    return _lines(keys, within="points", in_hex=in_hex)


def _hex_keys(texts: Texts, digits: int) -> dict[str, str]:
    return {f"0x{number:0{digits}X}": text for number, text in texts.items()}


def _keys(part: msgspec.Struct, leave_out: Iterable[str] = ()) -> dict[str, Any]:
    """The keys and values of a part of a profile, such as a point. Keys with default values and the
    keys `leave_out` are left out.
    """
    keys = {name: getattr(part, name) for name in part.__struct_fields__ if name not in leave_out}
    defaults = _defaults(type(part))
    return {
        key: value for key, value in keys.items() if key not in defaults or value != defaults[key]
    }


@functools.cache
def _defaults(part: type[msgspec.Struct]) -> dict[str, Any]:
    defaults = {}
    for field in msgspec.structs.fields(part):
        if field.default_factory is not msgspec.NODEFAULT:
            defaults[field.name] = field.default_factory()
        elif field.default is not msgspec.NODEFAULT:
            defaults[field.name] = field.default
    return defaults


def _lines(keys: Mapping[str, Any], within: str = "", in_hex: Iterable[str] = ()) -> list[str]:
    """Return a TOML line for each key. A long list takes several lines; a long dictionary gets a
    TOML table of its own.

    `within` is the name of the TOML table that contains the keys. The values of the keys `in_hex`
    are written in hexadecimal.
    """
    lines, tables = [], []
    for key, value in keys.items():
        text = f"0x{value:04X}" if key in in_hex else _value(value)
        if len(key) + len(text) + 3 <= _WIDTH:
            lines.append(f"{key} = {text}")
        elif isinstance(value, list):
            lines += [f"{key} = [", *(f"    {_value(item)}," for item in value), "]"]
        elif isinstance(value, dict):
            tables += ["", f"[{within}.{key}]", *(f"{k} = {_value(v)}" for k, v in value.items())]
        else:
            lines.append(f"{key} = {text}")
    return lines + tables


def _value(value: Any) -> str:
    match value:
        case bool():
            return "true" if value else "false"
        case int():
            return str(value)
        case float():
            return str(int(value)) if value.is_integer() and abs(value) < 1e15 else repr(value)
        case str():
            # A quoted string is the same in JSON and TOML, except that TOML must also escape the
            # character DEL.
            return json.dumps(str(value), ensure_ascii=False).replace("\x7f", "\\u007f")
        case list():
            return f"[{', '.join(map(_value, value))}]"
        case _:
            return _inline(value)


def _inline(keys: Mapping[Any, Any]) -> str:
    pairs = ", ".join(f"{key} = {_value(value)}" for key, value in keys.items())
    return f"{{ {pairs} }}" if pairs else "{}"
