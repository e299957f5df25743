from __future__ import annotations

import json
import tomllib
from pathlib import Path

import pytest

from mbtool.core.nesting import MAX_DEPTH, MAX_NUMBER, why_refused
from mbtool.devices import builtin_profiles

PROFILES = Path(__file__).resolve().parents[2] / "mbtool" / "devices" / "profiles"

MANY_QUOTES = {
    "escaped quotes": '"' + '\\"' * 200_000,
    "apostrophes": "'" * 200_001,
    "triple quotes that do not end": '"""' + '""a' * 100_000,
    "triple quotes behind backslashes": '"""' + '\\"""\n' * 80_000 + "\\",
    "triple apostrophes that do not end": "'''" + "''a" * 100_000,
    "comments": "# a\n" * 100_000,
    "backslashes": '"' + "\\" * 400_000,
    "one long word": "a" * 400_000,
}


@pytest.mark.parametrize(
    ("text", "what"),
    [
        (".".join("a" * (MAX_DEPTH + 1)) + " = 1", "parts"),
        ("[" + " . ".join("a" * (MAX_DEPTH + 1)) + "]", "parts"),
        (".".join(['"a"'] * (MAX_DEPTH + 1)) + " = 1", "parts"),
        ("a = { b = 1, " + ".".join("a" * (MAX_DEPTH + 1)) + " = 1 }", "parts"),
        ("a = " + "[" * (MAX_DEPTH + 1), "brackets"),
        ("a = " + "{a=" * (MAX_DEPTH + 1), "brackets"),
        ('{"a":' * (MAX_DEPTH + 1), "brackets"),
        ('a = "\\"" # "\nb = ' + "[" * (MAX_DEPTH + 1), "brackets"),
        ('a = """\n""""" + "\nb = ' + "[" * (MAX_DEPTH + 1), "brackets"),
        ("a = 0x" + "f" * MAX_NUMBER, "digits"),
        ("a = [1, -" + "9" * (MAX_NUMBER + 1) + "]", "digits"),
        ('{"a": 1' + "0" * MAX_NUMBER + "}", "digits"),
    ],
)
def test_refuses_what_is_deeper_or_longer_than_in_any_file_that_is_read(
    text: str, what: str
) -> None:
    assert what in (why_refused(text) or "")


@pytest.mark.parametrize(
    "text",
    [
        ".".join("a" * MAX_DEPTH) + " = 1",
        "a = " + "[" * MAX_DEPTH + "]" * MAX_DEPTH,
        f"a = [{', '.join(['1.5'] * 100)}]",
        "a.b = 1\n" * 100,
        "a = [1]\n" * 100,
        f"a{'1' * 200} = {'1' * MAX_NUMBER}",
        f'a = "{"[" * 100}{"." * 100}"',
        f"a = '{'[' * 100}' # {'[' * 100}",
        f"a = '''\n{'[' * 100}\n'{'[' * 100}'''",
        f'a = """\n{"[" * 100}\n\\"""{"[" * 100}"""',
        json.dumps({"a": "[" * 100 + "\\\"'" + "#" + "[" * 100}),
    ],
)
def test_accepts_any_number_of_shallow_values_and_whatever_stands_in_quotes(text: str) -> None:
    assert why_refused(text) is None


@pytest.mark.parametrize("name", builtin_profiles())
def test_accepts_the_built_in_profiles_as_toml_and_as_json(name: str) -> None:
    text = (PROFILES / f"{name}.toml").read_text(encoding="utf-8")
    assert why_refused(text) is None
    assert why_refused(json.dumps(tomllib.loads(text), default=str)) is None


@pytest.mark.parametrize("text", MANY_QUOTES.values(), ids=MANY_QUOTES)
def test_looks_at_each_character_a_fixed_number_of_times(text: str) -> None:
    # One that grew with the square of the length would need minutes for each of these.
    assert why_refused(text) is None
