from __future__ import annotations

import re
import tomllib
from typing import TYPE_CHECKING

import pytest
from hypothesis import given, settings
from jsonschema import Draft7Validator

from mbtool.devices.dumping import dump_profile
from mbtool.devices.loading import (
    builtin_profiles,
    load_profile,
    profile_from_json,
    profile_to_json,
)
from mbtool.devices.schema import profile_schema
from tests.devices.made_profiles import profiles

if TYPE_CHECKING:
    from pathlib import Path

    from mbtool.devices.model import Profile

WRITTEN = """\
name = "pump-7"
title = "Feed \\"pump\\" 7"
vendor = "Maker"
transports = ["rtu", "ascii"]
source = "operating instructions, edition 3"
model_code = 0x0016
any_unit = true
notes = [
    "What the pump does when its tank is empty is not documented; that it stops is assumed.",
    "A second one.",
]

[functions]
03 = { limit = 16, ascii_limit = 8 }
06 = {}
41 = { title = "remote reset", answers = false }

[functions.42]
title = "read model name"

[functions.42.answer]
name = "Model code"
texts = { 0x0016 = "pump-7" }

[exceptions]
value = 2
documented = [1, 2, 17]
texts = { 0x11 = "value out of setting range" }

[timing]
t3_5 = "28bits"
request_interval = "5ms"

[[areas]]
name = "data register"
table = "holding_registers"
first = 0
last = 199
access = "rw"
prefix = "D"

[[areas]]
name = "buffer memory"
table = "holding_registers"
first = 0x0100
last = 0x01FF
access = "rw"
base = -256
radix = "hex"
width = 4
suffix = "H"

[[points]]
name = "Speed"
table = "holding_registers"
address = 10
type = "int16"
unit = "rpm"
scale = 0.1
offset = -50
decimals = 1
minimum = -20
maximum = 27.5

[[points]]
name = "State"
table = "holding_registers"
address = 0x0100
type = "flags"
bits = { 0 = "READY", 3 = "ALARM" }
default = 0x8001

[[points]]
name = "Alarm code"
table = "holding_registers"
address = 0x0101
type = "hex16"
note = "Kept until the next start."

[points.texts]
0x0E30 = "the tank is empty and the pump has stopped"
0x0E40 = "the motor is too warm and the pump has stopped"
"""


def _load(folder: Path, text: str) -> Profile:
    path = folder / "dumped.toml"
    path.write_text(text, encoding="utf-8")
    return load_profile(str(path))


def test_profile_is_written_as_a_reader_would_write_it(tmp_path: Path) -> None:
    assert dump_profile(_load(tmp_path, WRITTEN)) == WRITTEN


@pytest.mark.parametrize("name", builtin_profiles())
def test_a_dumped_built_in_profile_loads_as_an_equal_one(name: str, tmp_path: Path) -> None:
    profile = load_profile(name)
    text = dump_profile(profile)
    assert _load(tmp_path, text) == profile
    assert dump_profile(_load(tmp_path, text)) == text
    assert "extends" not in tomllib.loads(text)


def test_comments_stand_before_their_part(tmp_path: Path) -> None:
    profile = _load(tmp_path, WRITTEN)
    text = dump_profile(
        profile,
        {
            "": ["Made from\nseen traffic.", "word " * 25],
            "functions": ["Seen: 3."],
            'areas "buffer memory"': ["Guessed."],
            'points "Speed"': [""],
        },
    )
    assert text.startswith("# Made from?seen traffic.\n# word word")
    assert "\n\n# Seen: 3.\n[functions]\n" in text
    assert '\n\n# Guessed.\n[[areas]]\nname = "buffer memory"\n' in text
    assert '\n\n#\n[[points]]\nname = "Speed"\n' in text
    assert max(len(line) for line in text.splitlines() if line.startswith("#")) <= 100
    assert _load(tmp_path, text) == profile


def test_addresses_are_hexadecimal_where_the_manuals_are() -> None:
    text = dump_profile(load_profile("fa3-at1m8x"))
    assert re.search(r"^address = \d+$", text, re.MULTILINE) is None
    assert "address = 0x0102\n" in text
    assert "0x" not in dump_profile(load_profile("idec-ft1a-touch"))


@given(profile=profiles())
@settings(max_examples=40)
def test_any_dumped_profile_loads_as_an_equal_one(
    profile: Profile, tmp_path_factory: pytest.TempPathFactory
) -> None:
    text = dump_profile(profile)
    assert _load(tmp_path_factory.getbasetemp(), text) == profile
    assert profile_from_json(profile_to_json(profile), "a log") == profile
    assert Draft7Validator(profile_schema()).is_valid(tomllib.loads(text))


def test_comments_are_before_their_parts_and_cannot_be_escaped() -> None:
    profile = load_profile("idec-ft1a-touch")
    area = profile.areas[0].name
    text = dump_profile(
        profile,
        {
            "": ["The head. " * 20, ""],
            "functions": ["About functions."],
            f'areas "{area}"': ["One line\nname = 1"],
        },
    )
    assert text.startswith("# The head. The head.")
    assert "\n# About functions.\n[functions]\n" in text
    assert "\n# One line?name = 1\n[[areas]]\n" in text
    assert max(len(line) for line in text.splitlines() if line.startswith("#")) <= 100
    assert tomllib.loads(text) == tomllib.loads(dump_profile(profile))
