"""Loads device profiles: built-in ones by name, a user's own by path."""

# A profile file is TOML; docs/devices.md lists its keys. A file may extend another one, which the
# key `extends` names: a built-in profile, or a path relative to the file. Then the file has only
# the keys that differ, and is merged with the extended file:
#
#   functions, exceptions,
#   timing                  merged key by key
#   areas, points           added to those of the extended file; replace one of the same name
#   notes                   added to those of the extended file
#   any other key           replaces the key of the extended file
#
# Each file is checked key by key before it is merged, so that an error names the right file.
#
# Limits: 1 MiB for each file; a chain of 8 files that extend one another; 8 MiB for a profile in a
# log. Neither may nest tables and lists deeper than core/nesting.py allows.

from __future__ import annotations

import datetime
import difflib
import functools
import json
import re
import reprlib
import typing
from enum import StrEnum
from pathlib import Path
from typing import Any, TypeVar

import msgspec

from mbtool.core.errors import InputError, ProfileError, UsageError, reason_of
from mbtool.core.nesting import MAX_NUMBER, why_refused
from mbtool.devices.model import AnswerWord, Area, Exceptions, FunctionRule, Point, Profile, Timing
from mbtool.devices.schema import description
from mbtool.devices.validation import validate

# The code below reads a user's TOML file: a profile, start values, or a list of faults.
#
# It is not in core/, because core/ does no I/O. The caller states the largest file size.

_ADVICE = (
    ("Invalid value", "; a value is a number, a text in quotes, true, false, a list or a table"),
    ("Expected newline", "; a line has one key and its value"),
    ("Cannot overwrite a value", "; the key of this line stands further up already"),
    ("Cannot declare", "; a table is begun once, and [[...]] adds one to a list"),
    ("Illegal character", "; a text ends in the line where it begins: is a quote missing?"),
    ("Invalid statement", "; write key = value, or [table]"),
    ("Expected '=' after a key", "; write key = value, and quotes around a key with spaces"),
)
"""Pairs of two texts: the beginning of an error message of the TOML parser, and advice for the user
to append to the message."""


class TomlError(UsageError):
    """Raised for a file that is not TOML."""

    def __init__(self, file: str, place: str, problem: str) -> None:
        super().__init__(f"{file}: {place}: {problem}")
        self.place = place
        """The place of the mistake: a line, byte or key of the file, or a word such as `size`."""
        self.problem = problem


def read_toml(path: Path, max_bytes: int, what: str, hint: str = "") -> dict[str, Any]:
    """Read the keys and values of a TOML file, in the order of the file.

    Raises InputError if the file cannot be read, TomlError if it is longer than `max_bytes`, nests
    too deep, or is not TOML. `what` names the kind of file in messages, such as `profile`; `hint`
    is appended to the parser's message about a line.
    """
    file = str(path)
    try:
        with path.open("rb") as stream:
            data = stream.read(max_bytes + 1)
    except OSError as error:
        raise InputError(f"{file}: cannot be read: {reason_of(error)}") from error
    return parse_toml(data, file, max_bytes, what, hint)


def parse_toml(data: bytes, file: str, max_bytes: int, what: str, hint: str = "") -> dict[str, Any]:
    """Read the keys and values of the content of a TOML file, as read_toml() does.

    Raises TomlError, which names the file `file`.
    """
    import tomllib  # Imported here: most commands read no such file.

    if len(data) > max_bytes:
        raise TomlError(file, "size", f"more than {max_bytes} bytes are no {what}")
    try:
        text = data.decode("utf-8-sig")  # Some editors write a byte order mark.
        if refused := why_refused(text):
            raise TomlError(file, "TOML", refused)
        return tomllib.loads(text)
    except UnicodeDecodeError as error:
        problem = "not UTF-8, so not TOML; save it as UTF-8"
        raise TomlError(file, f"byte {error.start}", problem) from error
    except ValueError as error:
        problem, at, place = str(error).rpartition(" (at ")
        problem = problem if at else str(error)
        advice = next((words for known, words in _ADVICE if problem.startswith(known)), "")
        raise TomlError(
            file,
            place.rstrip(")") if at else "TOML",
            f"not TOML: {problem}{advice}{hint and f'; {hint}'}",
        ) from error


MAX_FILE_BYTES = 1 << 20
MAX_EXTENDED = 8
MAX_JSON_BYTES = MAX_EXTENDED * MAX_FILE_BYTES
_MAX_EXAMPLES = 8

_BUILT_IN = Path(__file__).parent / "profiles"

_T = TypeVar("_T", bound=msgspec.Struct)


def builtin_profiles() -> list[str]:
    """Return the names of the built-in profiles, sorted. Lists their folder, but opens no file."""
    # Leave out files whose name begins with an underscore: they describe no device, and only serve
    # other profiles as a common base.
    return sorted(path.stem for path in _BUILT_IN.glob("[!_]*.toml"))


def load_profile(name_or_path: str) -> Profile:
    """Load a built-in profile by its name, or a TOML file by its path.

    Raises ProfileError for mistakes in a file, InputError for a file that cannot be read, and
    UsageError for an unknown name.
    """
    if name_or_path in builtin_profiles():
        return _load_builtin(name_or_path)
    path = Path(name_or_path)
    if path.suffix == ".toml" or any(separator in name_or_path for separator in "/\\"):
        return _load_file(path)
    raise UsageError(_unknown_name(name_or_path))


def profile_from_toml(text: str, path: str) -> Profile:
    """Read a profile from the text that is to be written to the file at `path`.

    Raises ProfileError for mistakes, and InputError if a file that it extends cannot be read.
    """
    file = Path(path)
    return _finish(_read(file, data=text.encode()), str(file))


def profile_to_json(profile: Profile) -> bytes:
    """Write a profile as JSON, to attach it to a log. The JSON is complete: it needs no other
    profile.
    """
    return msgspec.json.encode(profile)


def profile_from_json(data: bytes, file: str) -> Profile:
    """Read a profile from the JSON that profile_to_json() writes.

    `file` names the source in messages. Raises ProfileError if the data is no JSON object, is too
    large or nests too deep, or has mistakes.
    """
    if len(data) > MAX_JSON_BYTES:
        raise ProfileError(file, "size", f"more than {MAX_JSON_BYTES} bytes are no profile")
    try:
        text = data.decode("utf-8")
        if refused := why_refused(text):
            raise ProfileError(file, "JSON", refused)
        keys = json.loads(text)
    except ValueError as error:
        raise ProfileError(file, "JSON", f"cannot be read: {error}") from error
    if not isinstance(keys, dict):
        raise ProfileError(file, "JSON", "expected an object")
    return _finish(_parse_parts(keys, file), file)


@functools.cache
def _load_builtin(name: str) -> Profile:
    return _load_file(_BUILT_IN / f"{name}.toml")


def _load_file(path: Path) -> Profile:
    return _finish(_read(path), str(path))


def _finish(keys: dict[str, Any], file: str) -> Profile:
    profile = _convert(Profile, keys, file, "")
    validate(profile, file)
    return profile


def _unknown_name(name: str) -> str:
    return (
        f"profile {name!r}: there is none of that name{_guess(name) or '.'} "
        f"The built-in ones are {', '.join(builtin_profiles())}; "
        "a file of your own is named by its path, for example ./pump.toml"
    )


def _guess(name: str) -> str:
    known = builtin_profiles()
    near = difflib.get_close_matches(name.lower(), known, n=2, cutoff=0.5)
    near = near or [each for each in known if name and each.startswith(name.lower())]
    return f"; did you mean {' or '.join(near)}?" if near else ""


def _read(
    path: Path, extending: tuple[Path, ...] = (), data: bytes | None = None
) -> dict[str, Any]:
    """Read the keys of a file, merged with those of all files that it extends.

    `extending` has the files that lead to this one by their keys `extends`, the user's file first.
    `data` is the content of the file; with None it is read.
    Raises InputError if a file cannot be read, and ProfileError for mistakes in it.
    """
    file = str(path)
    keys = _read_toml(path, data)
    extends = keys.pop("extends", None)
    own = _parse_parts(keys, file)
    if extends is None:
        return own
    if not isinstance(extends, str):
        raise ProfileError(
            file, "extends", f"expected a profile's name or path, not {_value_text(extends)}"
        )
    extended = _BUILT_IN / f"{extends}.toml"
    if "/" in extends or not extended.is_file():
        extended = path.parent / extends
    if not extended.is_file():
        advice = _guess(extends) or "; name a built-in one or a file beside this one"
        raise ProfileError(file, "extends", f"no profile {extends!r}{advice}")
    chain = (*extending, path)
    if any(extended.samefile(each) for each in chain):
        raise ProfileError(
            file,
            "extends",
            f"{extends!r} is this file, or extends it in turn; one of them must stand alone",
        )
    if len(chain) == MAX_EXTENDED:
        raise ProfileError(
            file, "extends", f"more than {MAX_EXTENDED} files extend one another; put some together"
        )
    return _merge(_read(extended, chain), own)


def _read_toml(path: Path, data: bytes | None) -> dict[str, Any]:
    try:
        if data is not None:
            return parse_toml(data, str(path), MAX_FILE_BYTES, "profile")
        return read_toml(path, MAX_FILE_BYTES, "profile")
    except TomlError as error:
        raise ProfileError(str(path), error.place, error.problem) from error


def _merge(extended: dict[str, Any], own: dict[str, Any]) -> dict[str, Any]:
    merged = extended | own
    for key in ("functions", "exceptions", "timing"):
        if key in extended and key in own:
            merged[key] = extended[key] | own[key]
    for key in ("areas", "points"):
        if key in extended and key in own:
            # If `own` has two areas or points with one name, only the first replaces the area or
            # point of that name in the extended file. The second is also kept, so that validation
            # reports it.
            indices = {part.name: index for index, part in enumerate(extended[key])}
            merged[key] = list(extended[key])
            for part in own[key]:
                index = indices.pop(part.name, len(merged[key]))
                merged[key][index : index + 1] = [part]
    if "notes" in extended and "notes" in own:
        merged["notes"] = extended["notes"] + own["notes"]
    return merged


def _parse_parts(keys: dict[str, Any], file: str) -> dict[str, Any]:
    """Check the keys of the file `file`, and convert its areas, points and functions to their
    classes.

    All other keys keep their TOML values; they are converted after the file is merged with the one
    that it extends.
    """
    _refuse_unknown(Profile, keys, file, "")
    parts = dict(keys)
    if "areas" in keys:
        parts["areas"] = _parse_list(Area, keys["areas"], file, "areas")
    if "points" in keys:
        parts["points"] = _parse_points(keys["points"], file)
    if "functions" in keys:
        parts["functions"] = _parse_functions(keys["functions"], file)
    if "exceptions" in keys:
        exceptions = _convert(Exceptions, keys["exceptions"], file, "exceptions")
        parts["exceptions"] = dict(keys["exceptions"])
        if exceptions.texts:
            parts["exceptions"]["texts"] = exceptions.texts
    if "timing" in keys:
        _convert(Timing, keys["timing"], file, "timing")
    if not isinstance(keys.get("notes", []), list):
        raise ProfileError(file, "notes", _expected_list(keys["notes"], []))
    return parts


def _parse_list(cls: type[_T], value: Any, file: str, key: str) -> list[_T]:
    if not isinstance(value, list):
        what = f"one [{key}]" if isinstance(value, dict) else _value_text(value)
        raise ProfileError(file, key, f"expected [[{key}]] tables, not {what}")
    parts = []
    for index, item in enumerate(value):
        name = item.get("name") if isinstance(item, dict) else None
        label = f'{key} "{name}"' if isinstance(name, str) else f"{key}[{index}]"
        parts.append(_convert(cls, item, file, label))
    return parts


def _parse_points(value: Any, file: str) -> list[Point]:
    """Parse the points of a file.

    A point without the key `stride` gets the number of addresses that each of its values takes.
    """
    points = _parse_list(Point, value, file, "points")
    return [
        point if "stride" in keys else _side_by_side(point)
        for point, keys in zip(points, value, strict=True)
    ]


def _side_by_side(point: Point) -> Point:
    return msgspec.structs.replace(point, stride=point.words if point.count > 1 else 1)


def _parse_functions(value: Any, file: str) -> dict[str, FunctionRule]:
    if not isinstance(value, dict):
        raise ProfileError(
            file, "functions", f"expected a table, [functions], not {_value_text(value)}"
        )
    rules = {}
    for code, rule in value.items():
        if re.fullmatch("[0-7][0-9A-Fa-f]", code) is None or int(code, 16) == 0:
            raise ProfileError(
                file,
                f"functions.{code}",
                "a function code is two hexadecimal digits, 01 to 7F, for example 10 for 16",
            )
        if code.upper() in rules:
            raise ProfileError(file, f"functions.{code}", "the function has its key already")
        rules[code.upper()] = _convert(FunctionRule, rule, file, f"functions.{code}")
    return rules


def _convert(cls: type[_T], value: Any, file: str, key: str) -> _T:
    """Convert one part of a profile to the class `cls`; `value` is the part's TOML table.

    `key` is the part's name for messages. Raises ProfileError for the first wrong key.
    """
    if not isinstance(value, dict):
        raise ProfileError(
            file, key, f"expected a table, {{ key = value }}, not {_value_text(value)}"
        )
    _refuse_unknown(cls, value, file, key)
    for name in _required_fields(cls):
        if name not in value:
            about = description(cls, name).partition("\n")[0].removesuffix(".")
            raise ProfileError(
                file, _join(key, name), f"this key is missing: {about[0].lower()}{about[1:]}"
            )
    fields = dict(value)
    for name in ("texts", "bits", "units"):
        if name in value:
            fields[name] = _parse_texts(value[name], file, _join(key, name))
    if cls is FunctionRule and "answer" in value:
        fields["answer"] = _convert(AnswerWord, value["answer"], file, _join(key, "answer"))
    try:
        return msgspec.convert(fields, cls)
    except msgspec.ValidationError as error:
        where, problem = _explain(str(error), cls, fields)
        raise ProfileError(file, _join(key, where), problem) from error


@functools.cache
def _required_fields(cls: type[msgspec.Struct]) -> list[str]:
    return [field.name for field in msgspec.structs.fields(cls) if field.required]


def _refuse_unknown(cls: type[msgspec.Struct], value: dict[str, Any], file: str, key: str) -> None:
    known = cls.__struct_fields__
    for name in value:
        if name not in known:
            near = difflib.get_close_matches(name, known, n=1)
            advice = f"did you mean {near[0]!r}?" if near else f"the keys are {', '.join(known)}"
            raise ProfileError(file, _join(key, name), f"unknown key; {advice}")


def _parse_texts(value: Any, file: str, key: str) -> dict[int, str]:
    if not isinstance(value, dict):
        raise ProfileError(
            file, key, f"expected a table of value and text, not {_value_text(value)}"
        )
    texts = {}
    for number, text in value.items():
        if len(number) > MAX_NUMBER:
            raise ProfileError(file, key, f"a key of more than {MAX_NUMBER} digits")
        try:
            parsed = int(number, 0)
        except ValueError:
            raise ProfileError(
                file, f"{key}.{number}", "the key is no number; write 3 or 0x0E30"
            ) from None
        if parsed in texts:
            raise ProfileError(file, f"{key}.{number}", f"{parsed} has its text already")
        if not isinstance(text, str):
            raise ProfileError(file, f"{key}.{number}", f"expected a text, not {_value_text(text)}")
        texts[parsed] = text
    return texts


# An error message of msgspec, such as "Expected `int` <= 65535 - at `$.first`".
_MESSAGE = re.compile(r"(?P<problem>.*?)(?:, got .*?)?(?: - at `\$\.?(?P<path>[^`]*)`)?")
_STEP = re.compile(r"(\w+)|\[(\d+)\]")
_WORDS = {
    "int": "a whole number",
    "float": "a number",
    "int | float": "a number",
    "str": "a text",
    "bool": "true or false",
    "array": "a list",
    "object": "a table",
}


def _explain(message: str, cls: type[msgspec.Struct], value: Any) -> tuple[str, str]:
    """Return the key that an error message of msgspec is about, and the mistake in words for the
    user.

    `value` is the TOML table that was to be converted to `cls`.
    """
    match = _MESSAGE.fullmatch(message)
    if match is None or not match["path"]:
        return "", message
    for name, index in _STEP.findall(match["path"]):
        value = value[name] if name else value[int(index)]
    choices = _choices(cls, match["path"])
    if match["problem"] == "Expected `array`":
        of_numbers = match["path"] == "documented"
        return match["path"], _expected_list(value, choices, of_numbers=of_numbers)
    if choices:
        return match["path"], f"expected one of {', '.join(choices)}, not {_value_text(value)}"
    problem = re.sub(
        r"`([\w| ]+?)( \| null)?`", lambda type_: _WORDS.get(type_[1], type_[1]), match["problem"]
    )
    return match["path"], f"{problem[0].lower()}{problem[1:]}, not {_value_text(value)}"


def _expected_list(value: object, choices: list[str], *, of_numbers: bool = False) -> str:
    if of_numbers and isinstance(value, str):
        numbers = re.findall(r"\b(?:0x[0-9A-Fa-f]+|[0-9]+)\b", value)[:_MAX_EXAMPLES]
        example = ", ".join(numbers) or "1, 2"
    else:
        example = _value_text(choices[0] if choices and value not in choices else value)
    return f"expected a list, for example [{example}], not {_value_text(value)}"


def _choices(cls: type[msgspec.Struct], path: str) -> list[str]:
    """Return the texts that are allowed as the value of a key; none if its type is no enumeration.

    `path` is the place of the value in msgspec's message, such as `transports[0]`; it begins with
    the key, which is a field of `cls`.
    """
    hint = typing.get_type_hints(cls)[re.split(r"[.\[]", path)[0]]
    for kind in (hint, *typing.get_args(hint)):
        if isinstance(kind, type) and issubclass(kind, StrEnum):
            return [member.value for member in kind]
    return []


def _join(key: str, name: str) -> str:
    return f"{key}.{name}" if key and name else key or name


def _value_text(value: object) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, datetime.date | datetime.time):
        return str(value)
    return reprlib.repr(value)
