"""Every kind of wrong profile, with the whole line that its author reads."""

from __future__ import annotations

import json
import math
import re
import tomllib
from typing import TYPE_CHECKING, Any

import pytest
from jsonschema import Draft7Validator

from mbtool.core.errors import MbtoolError, ProfileError
from mbtool.devices.loading import MAX_FILE_BYTES, load_profile, profile_from_json
from mbtool.devices.model import AnswerWord, Area, Exceptions, FunctionRule, Point, Profile, Timing
from mbtool.devices.schema import profile_schema
from tests.devices.pump import PUMP

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path


def _area(name: str, first: int, last: int, access: str) -> str:
    return (
        f'[[areas]]\nname = "{name}"\ntable = "holding_registers"\nfirst = {first}\nlast = {last}\n'
        f'access = "{access}"\n'
    )


def _point(name: str, address: int) -> str:
    return f'[[points]]\nname = "{name}"\ntable = "holding_registers"\naddress = {address}\n'


# fmt: off
WRONG = [
    # The text is not TOML.
    ("last = 9", "last =",
     "line 15, column 7: not TOML: Invalid value; a value is a number, a text in quotes, true, "
     "false, a list or a table"),
    ("last = 9", "last = 9 10",
     "line 15, column 10: not TOML: Expected newline or end of document after a statement; a line"
     " has one key and its value"),
    ("last = 9", "last = 9\nlast = 8",
     "line 16, column 9: not TOML: Cannot overwrite a value; the key of this line stands further "
     "up already"),
    ('"pump"', '"pump',
     "line 2, column 13: not TOML: Illegal character '\\n'; a text ends in the line where it "
     "begins: is a quote missing?"),
    ("last = 9", "last : 9",
     "line 15, column 6: not TOML: Expected '=' after a key in a key/value pair; write key = "
     "value, and quotes around a key with spaces"),
    ("[[areas]]", "[[areas]",
     "line 11, column 8: not TOML: Expected ']]' at the end of an array declaration"),
    ("[[points]]", "[functions]",
     "line 18, column 11: not TOML: Cannot declare ('functions',) twice; a table is begun once, "
     "and [[...]] adds one to a list"),
    # A value of the wrong type.
    ("last = 9", 'last = "9"', "areas \"data\".last: expected a whole number, not '9'"),
    ("last = 9", "last = 9.5", 'areas "data".last: expected a whole number, not 9.5'),
    ("last = 9", "last = true", 'areas "data".last: expected a whole number, not true'),
    ("address = 3", "address = 3\nnote = 2024-01-01",
     'points "Speed".note: expected a text, not 2024-01-01'),
    ('title = "A pump"', "title = 5", "title: expected a text, not 5"),
    ("address = 3", "address = 3\nscale = '0.1'",
     "points \"Speed\".scale: expected a number, not '0.1'"),
    ('source = "its manual"', 'source = "its manual"\nany_unit = "yes"',
     "any_unit: expected true or false, not 'yes'"),
    ('source = "its manual"', 'source = "its manual"\ncomplete_areas = "all"',
     "complete_areas: expected true or false, not 'all'"),
    ('["rtu"]', '"rtu"', "transports: expected a list, for example ['rtu'], not 'rtu'"),
    ('source = "its manual"', 'source = "its manual"\nnotes = "n"',
     "notes: expected a list, for example ['n'], not 'n'"),
    ('source = "its manual"', 'source = "its manual"\nnotes = [1]',
     "notes[0]: expected a text, not 1"),
    ("{ limit = 16 }", "16", "functions.03: expected a table, { key = value }, not 16"),
    ("limit = 16", "answer = 1", "functions.03.answer: expected a table, { key = value }, not 1"),
    ("[functions]", 'timing = "28bits"\n\n[functions]',
     "timing: expected a table, { key = value }, not '28bits'"),
    ("[[points]]", "[points]", "points: expected [[points]] tables, not one [points]"),
    ("[[areas]]", "[areas]", "areas: expected [[areas]] tables, not one [areas]"),
    ("address = 3", "address = 3\ntexts = 5",
     'points "Speed".texts: expected a table of value and text, not 5'),
    ("address = 3", "address = 3\ntexts = { 1 = 2 }",
     'points "Speed".texts.1: expected a text, not 2'),
    ('name = "Speed"', "name = 1", "points[0].name: expected a text, not 1"),
    ("[functions]", "[exceptions]\ndocumented = [1, 2, 3, 'x']\n\n[functions]",
     "exceptions.documented[3]: expected a whole number, not 'x'"),
    ('["rtu"]', '"usb"', "transports: expected a list, for example ['rtu'], not 'usb'"),
    ('source = "its manual"', 'source = "its manual"\nbehaviour = "fa4"',
     "behaviour: expected one of fa3, lt830, wago, not 'fa4'"),
    ("address = 3", "address = 3\nminimum = 'x'",
     "points \"Speed\".minimum: expected a number, not 'x'"),
    # A key that is unknown, missing or there twice.
    ("last = 9", "lost = 9", "areas \"data\".lost: unknown key; did you mean 'last'?"),
    ("limit = 16", "limits = 16", "functions.03.limits: unknown key; did you mean 'limit'?"),
    ("address = 3", "address = 3\nwordorder = 'low-first'",
     "points \"Speed\".wordorder: unknown key; did you mean 'word_order'?"),
    ("[[points]]", "[[point]]", "point: unknown key; did you mean 'points'?"),
    ('title = "A pump"\n', "", "title: this key is missing: the device's full name, for readers"),
    ("last = 9\n", "",
     'areas "data".last: this key is missing: last address on the wire, inclusive'),
    ('access = "rw"\n', "",
     'areas "data".access: this key is missing: what a master may do: read r, write w, both rw'),
    ("[functions]\n03 = { limit = 16 }\n", "",
     "functions: this key is missing: its functions, by code in two hexadecimal digits"),
    ('name = "Speed"\n', "",
     "points[0].name: this key is missing: the name; in a series, {n} is the number and "
     "{reference} the reference"),
    ("limit = 16", "answer = { texts = {} }",
     "functions.03.answer.name: this key is missing: the name of the word"),
    ("address = 3", "address = 3\ntexts = { 1 = 'on', 0x1 = 'off' }",
     'points "Speed".texts.0x1: 1 has its text already'),
    ("03 =", "0a = {}\n0A =", "functions.0A: the function has its key already"),
    # A number beyond its range.
    ("last = 9", "last = 70000", 'areas "data".last: expected a whole number <= 65535, not 70000'),
    ("first = 0", "first = -1", 'areas "data".first: expected a whole number >= 0, not -1'),
    ("last = 9", "last = 123456789012345678901234567890",
     'areas "data".last: expected a whole number <= 65535, not 123456789012345678901234567890'),
    ("last = 9", "last = 9\nwidth = 9", 'areas "data".width: expected a whole number <= 8, not 9'),
    ("limit = 16", "limit = 0", "functions.03.limit: expected a whole number >= 1, not 0"),
    ("limit = 16", "limit = 126",
     "functions.03.limit: 126 is more than the 125 that the standard allows for read holding "
     "registers"),
    ("[functions]", "[exceptions]\nvalue = 300\n\n[functions]",
     "exceptions.value: expected a whole number <= 255, not 300"),
    ('source = "its manual"', 'source = "its manual"\nmodel_code = 0x10000',
     "model_code: expected a whole number <= 65535, not 65536"),
    ("address = 3", "address = -1",
     'points "Speed".address: expected a whole number >= 0, not -1'),
    ("address = 3", "address = 3\ncount = 0",
     'points "Speed".count: expected a whole number >= 1, not 0'),
    ("address = 3", "address = 3\ndecimals = -1",
     'points "Speed".decimals: expected a whole number >= 0, not -1'),
    ("address = 3", "address = 3\ndefault = -1",
     'points "Speed".default: expected a whole number >= 0, not -1'),
    ("address = 3", "address = 3\ntype = 'string'\nlength = 126",
     'points "Speed".length: expected a whole number <= 125, not 126'),
    ("address = 3", "address = 3\nscale = 0",
     'points "Speed".scale: 0 scales nothing; 0.1 would be right for tenths'),
    ("address = 3", "address = 3\noffset = inf",
     'points "Speed".offset: inf is no number to add; -50 would be one'),
    ("address = 3", "address = 3\nminimum = nan",
     'points "Speed".minimum: nan is no limit; leave the key out'),
    # A word that is none of those there are.
    ('"rw"', '"write"', "areas \"data\".access: expected one of r, rw, w, not 'write'"),
    ('"holding_registers"\nfirst', '"registers"\nfirst',
     'areas "data".table: expected one of coils, discrete_inputs, holding_registers, '
     "input_registers, not 'registers'"),
    ('["rtu"]', '["usb"]',
     "transports[0]: expected one of rtu, ascii, tcp, rtu-tcp, udp, rtu-udp, not 'usb'"),
    ("last = 9", "last = 9\nradix = 'octal'",
     "areas \"data\".radix: expected one of decimal, hex, octal-digit, not 'octal'"),
    ("address = 3", "address = 3\ntype = 'word'",
     'points "Speed".type: expected one of bit, uint16, int16, bcd16, hex16, octets, uint32, '
     "int32, bcd32, float32, uint64, int64, float64, string, flags, bit-field, nibble-field, not "
     "'word'"),
    ("address = 3", "address = 3\nword_order = 'little'",
     "points \"Speed\".word_order: expected one of high-first, low-first, not 'little'"),
    ("address = 3", "address = 3\naccess = 'x'",
     "points \"Speed\".access: expected one of r, rw, w, not 'x'"),
    ('source = "its manual"', 'source = "s"\nextends = 1',
     "extends: expected a profile's name or path, not 1"),
    ('source = "its manual"', 'source = "s"\nextends = "x"',
     "extends: no profile 'x'; name a built-in one or a file beside this one"),
    ("03 =", "3 =",
     "functions.3: a function code is two hexadecimal digits, 01 to 7F, for example 10 for 16"),
    ("03 =", "83 =",
     "functions.83: a function code is two hexadecimal digits, 01 to 7F, for example 10 for 16"),
    ("address = 3", "address = 3\ntexts = { on = 'running' }",
     'points "Speed".texts.on: the key is no number; write 3 or 0x0E30'),
    ("[functions]", '[timing]\nt3_5 = "28 bit times"\n\n[functions]',
     "timing.t3_5: silence '28 bit times': write a number and bits, chars, ms or us, for example "
     "28bits or 5ms"),
    ("[functions]", '[timing]\nrequest_interval = "2s"\n\n[functions]',
     "timing.request_interval: silence '2s': write a number and bits, chars, ms or us, for "
     "example 28bits or 5ms"),
    ('"pump"', '"a/b"', "name: 'a/b': letters, digits, '-', '_' and '.' make a name"),
    ('source = "its manual"', 'source = "its manual"\nextends = "fa3-at1m9x"',
     "extends: no profile 'fa3-at1m9x'; did you mean fa3-at1m8x or fa3-at1m8y?"),
    ('source = "its manual"', 'source = "its manual"\nextends = "base.toml"',
     "extends: no profile 'base.toml'; name a built-in one or a file beside this one"),
    # Texts that would tear a line, or be obeyed by a terminal.
    ('title = "A pump"', 'title = "A \\u001b[31mpump"',
     "title: 'A \\x1b[31mpump' has a control character, '\\x1b'; leave it out"),
    ('name = "Speed"', 'name = "Sp\\need"',
     "points \"Sp?eed\".name: 'Sp\\need' has a control character, '\\n'; leave it out"),
    ('name = "data"', 'name = "data"\nprefix = "D\\u2028"',
     "areas \"data\".prefix: 'D\\u2028' has a control character, '\\u2028'; leave it out"),
    ("address = 3", 'address = 3\ntexts = { 1 = "o\\u0007n" }',
     "points \"Speed\".texts.1: 'o\\x07n' has a control character, '\\x07'; leave it out"),
    ("limit = 16", 'title = "a\\tb"',
     "functions.03.title: 'a\\tb' has a control character, '\\t'; leave it out"),
    ('source = "its manual"', 'source = "its manual"\nnotes = ["a\\u0000b"]',
     "notes: 'a\\x00b' has a control character, '\\x00'; leave it out"),
    # Keys of one part that do not go together.
    ('source = "its manual"', 'source = "its manual"\nfinding_prefix = "my dev"',
     "finding_prefix: 'my dev': letters, digits, '-', '_' and '.' make a prefix, as FA3 in "
     "FA3-Q16"),
    ("[functions]", '[timing]\nt1_5 = "50bits"\nt3_5 = "28bits"\n\n[functions]',
     "timing.t1_5: 50bits inside a frame is longer than t3_5, 28bits, which ends it"),
    ("address = 3", "address = 3\ntype = 'int16'\nword_order = 'low-first'",
     'points "Speed".word_order: int16 has one register; \'byte_order\' swaps its bytes'),
    ("address = 3", "address = 3\nstride = 2",
     "points \"Speed\".stride: there is only one such point; 'count' says how many there are"),
    ("address = 3", "address = 3\ncounted_from = 0",
     "points \"Speed\".counted_from: there is only one such point; 'count' says how many there "
     "are"),
    ('"Speed"', '"CH{n} speed"',
     "points \"CH{n} speed\".name: {n} counts several points; 'count' says how many there are"),
    ("[functions]", "[exceptions]\ndocumented = '1,0x2'\n\n[functions]",
     "exceptions.documented: expected a list, for example [1, 0x2], not '1,0x2'"),
    ("[functions]", "[exceptions]\ndocumented = 'all'\n\n[functions]",
     "exceptions.documented: expected a list, for example [1, 2], not 'all'"),
    # Areas, functions and exceptions that do not go together.
    ('["rtu"]', "[]", "transports: is empty; name rtu, ascii or tcp"),
    ("first = 0", "first = 12",
     'areas "data".last: 9 (0x0009) ends before it begins, at 12 (0x000C)'),
    ("last = 9", "last = 9\nbase = -1",
     'areas "data".base: -1 gives its first address, 0, the number -1; 0 or more would be right'),
    ("[[points]]", _area("second", 5, 12, "r") + "\n[[points]]",
     'areas "second".first: 5 (0x0005) lies in area "data" of the same table, which ends at 9 '
     "(0x0009); only an 'r' and a 'w' area may overlap"),
    ("[[points]]", _area("data", 10, 12, "r") + "\n[[points]]",
     'areas "data".name: another area has this name; give it one of its own'),
    ('table = "holding_registers"\nfirst', 'table = "input_registers"\nfirst',
     "areas \"data\".access: no function writes input_registers; 'r' would be right"),
    ("03 = { limit = 16 }", "16 = { limit = 100 }",
     "functions.16.limit: 100 is more than the 1 that the standard allows for mask write register; "
     "keys are hexadecimal, and write multiple registers, function 16, is 10"),
    ("03 = { limit = 16 }", "23 = { limit = 100 }",
     "functions.23.limit: the standard has none for function 23H; keys are hexadecimal, and "
     "read/write multiple registers, function 23, is 17"),
    ("03 = { limit = 16 }", "15 = { limit = 100 }",
     "functions.15.limit: the standard has none for write file record; keys are hexadecimal, and "
     "write multiple coils, function 15, is 0F"),
    ("limit = 16", "write_limit = 8",
     "functions.03.write_limit: only function 17 both reads and writes; 'limit' would be right"),
    ("03 = { limit = 16 }", "17 = { write_limit = 122 }",
     "functions.17.write_limit: 122 is more than the 121 that the standard allows function 17 to "
     "write"),
    ("limit = 16", "ascii_limit = 8",
     "functions.03.ascii_limit: the device is on no ASCII line; add 'ascii' to the transports"),
    ("limit = 16", 'answers = false, answer = { name = "x" }',
     "functions.03.answers: false, but 'answer' says what it answers; leave one out"),
    ("[functions]", "[exceptions]\nvalue = 4\n\n[functions]",
     "exceptions.value: 4 is not among the documented codes (1, 2, 3); add it there, or give "
     "another"),
    ("[functions]", "[exceptions]\ntexts = { 0x11 = 'out of range' }\n\n[functions]",
     "exceptions.texts: 17 (0x11) is not among the documented codes (1, 2, 3); add it there"),
    # A point that does not fit.
    ("address = 3", "address = 10",
     'points "Speed".address: holding_registers 10 (0x000A) is in no area; there are 0..9'),
    ("address = 3", "address = 9\ntype = 'float32'",
     'points "Speed".address: holding_registers 9..10 are not in one area; there are 0..9'),
    ('"holding_registers"\naddress', '"coils"\naddress',
     'points "Speed".type: uint16 does not fit coils; bit would be right'),
    ("address = 3", "address = 3\ntype = 'bit'",
     'points "Speed".type: bit does not fit holding_registers; a type of registers like uint16 '
     "would be right"),
    ("address = 3", "address = 3\n" + _point("Flow", 3),
     'points "Flow".address: holding_registers 3 (0x0003) is "Speed" already'),
    ("address = 3", "address = 3\n" + _point("Speed", 4),
     'points "Speed".name: another point has this name; give it one of its own'),
    ("address = 3", "address = 3\ncount = 2",
     'points "Speed".name: 2 points need {n} or {reference} in their name'),
    ('"Speed"', '"CH{no}"', 'points "CH{no}".name: only {n} and {reference} are filled in'),
    ('name = "Speed"', 'name = "CH{n}"\ncount = 2\nstride = 1\ntype = "int32"',
     'points "CH{n}".stride: 1 is less than the 2 addresses that each takes'),
    ("address = 3",
     "address = 20\n" + _area("commands", 20, 22, "w") + _area("states", 20, 22, "r"),
     'points "Speed".access: this key is missing; holding_registers 20 (0x0014) is read in one '
     "area and written in another: write 'r' or 'w'"),
    ("address = 3", 'address = 20\naccess = "w"\n' + _area("second", 20, 25, "r"),
     "points \"Speed\".access: 'w' is not what its area \"second\" allows: 'r'"),
    ("address = 3", "address = 3\nblock = 5",
     'points "Speed".block: 5 (0x0005) is behind the point itself, at 3 (0x0003)'),
    # A value of a point that cannot be.
    ("address = 3", "address = 3\ntype = 'string'",
     'points "Speed".length: this key is missing; it says how many registers the string takes'),
    ("address = 3", "address = 3\nlength = 4",
     'points "Speed".length: only a string has a length, not uint16'),
    ("address = 3", "address = 3\ntype = 'string'\nlength = 4\nword_order = 'low-first'",
     'points "Speed".word_order: the registers of a string stand in order; swap bytes by '
     "'byte_order'"),
    ("address = 3", "address = 3\ntype = 'flags'",
     'points "Speed".bits: this key is missing; name the bits, for example { 0 = "ready" }'),
    ("address = 3", "address = 3\ntype = 'flags'\nbits = { 16 = 'READY' }",
     'points "Speed".bits: a register has no bit 16, only 0 to 15'),
    ("address = 3", "address = 3\nbits = { 0 = 'READY' }",
     'points "Speed".bits: only flags have named bits, not uint16'),
    ("address = 3", "address = 3\ntype = 'flags'\nbits = { 0 = 'READY' }\nscale = 0.1",
     'points "Speed".scale: only numbers have it, for example int16, not flags'),
    ("address = 3", "address = 3\nchannels = 4",
     'points "Speed".channels: only bit-field and nibble-field have channels, not uint16'),
    ("address = 3", "address = 3\ntype = 'nibble-field'\nchannels = 5",
     'points "Speed".channels: 5 do not fit a register; 4 at most do'),
    ("address = 3", "address = 3\ntexts = { 70000 = 'none' }",
     'points "Speed".texts: 70000 does not fit uint16, which holds 0..65535'),
    ("address = 3", "address = 3\ntype = 'float32'\ntexts = { 1 = 'on' }",
     'points "Speed".texts: float32 has no texts; only whole numbers have them'),
    ("address = 3", "address = 3\nminimum = 5\nmaximum = 4",
     'points "Speed".minimum: 5 is more than the maximum, 4'),
    ("address = 3", "address = 3\ndefault = 5\nmaximum = 4",
     'points "Speed".default: 5 is more than the maximum, 4'),
    ("address = 3", "address = 3\nscale = 0.1\ndefault = 5\nminimum = 1",
     'points "Speed".default: 5, a value of 0.5, is less than the minimum, 1'),
    ("address = 3", "address = 3\ntype = 'bcd16'\ndefault = 0x1A",
     'points "Speed".default: 0x001A is no bcd16'),
    ("address = 3", "address = 3\ntype = 'float32'\ndefault = 4",
     'points "Speed".default: only a point of one register has a default, not the 2 of this'),
]
"""What to replace in PUMP, by what, and what is told behind the file's name."""
# fmt: on


def _told(text: str | bytes, folder: Path, monkeypatch: pytest.MonkeyPatch) -> str:
    monkeypatch.chdir(folder)
    data = text.encode() if isinstance(text, str) else text
    (folder / "pump.toml").write_bytes(data)
    with pytest.raises(MbtoolError) as caught:
        load_profile("pump.toml")
    return str(caught.value)


def test_the_profile_that_these_tests_change_is_valid(tmp_path: Path) -> None:
    (tmp_path / "pump.toml").write_text(PUMP, encoding="utf-8")
    assert load_profile(str(tmp_path / "pump.toml")).name == "pump"


def test_wrong_profile_is_told_in_one_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for old, new, told in WRONG:
        assert PUMP.count(old) == 1
        assert _told(PUMP.replace(old, new), tmp_path, monkeypatch) == f"pump.toml: {told}"


def test_each_mistake_has_its_own_message() -> None:
    told = [message for _, _, message in WRONG]
    assert len(set(told)) == len(told) > 40
    assert not any("\n" in message or "Error" in message for message in told)


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("", "name: this key is missing: the name for --device and the log: letters, digits, "
         "'-', '_' and '.'"),
        (b"name = \xff", "byte 7: not UTF-8, so not TOML; save it as UTF-8"),
        (PUMP.encode("utf-16"), "byte 0: not UTF-8, so not TOML; save it as UTF-8"),
        ("#" * (MAX_FILE_BYTES + 1), "size: more than 1048576 bytes are no profile"),
        ("a = " + "[" * 100_000, "TOML: nested too deep: more than 16 levels of brackets"),
        ("a." * 20_000 + "a = 1",
         "TOML: nested too deep: a key of more than 16 parts with dots between"),
        ("just words", "line 1, column 6: not TOML: Expected '=' after a key in a key/value pair; "
         "write key = value, and quotes around a key with spaces"),
        ('extends = "pump.toml"', "extends: 'pump.toml' is this file, or extends it in turn; one "
         "of them must stand alone"),
        ('extends = "fa3"', "extends: no profile 'fa3'; did you mean fa3-at1m8x or fa3-at1m8y or "
         "fa3-th1m16xc or fa3-th1m16y or fa3-th1m16ye?"),
    ],
)  # fmt: skip
def test_file_that_cannot_be_a_profile_is_told(
    text: str | bytes, told: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert _told(text, tmp_path, monkeypatch) == f"pump.toml: {told}"


@pytest.mark.parametrize(
    ("name", "told"),
    [
        ("folder.toml", "folder.toml: cannot be read: Is a directory"),
        ("folder.toml/none.toml", "folder.toml/none.toml: cannot be read: No such file or "
         "directory"),
        ("./folder.toml", "folder.toml: cannot be read: Is a directory"),
    ],
)  # fmt: skip
def test_file_that_cannot_be_read_is_told(
    name: str, told: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "folder.toml").mkdir()
    with pytest.raises(MbtoolError) as caught:
        load_profile(name)
    assert str(caught.value) == told


ALL_KEYS = """
name = "pump"
title = "A pump"
vendor = "Maker"
transports = ["rtu", "ascii"]
source = "its manual"
behaviour = "fa3"
finding_prefix = "P"
model_code = 1
last_unit = 99
any_unit = true
complete_areas = true
notes = ["a note"]
functions = { 03 = { limit = 16, ascii_limit = 8, data = "00", title = "t", answers = true, echoes = true, doubtful = true, value = 3, documented = [3] }, 17 = { write_limit = 9 }, 42 = { answer = { name = "c", texts = { 1 = "x" } } } }
exceptions = { function = 1, address = 2, value = 3, documented = [1, 2, 3], causes = ["value"], texts = { 2 = "x" } }
timing = { t1_5 = "1ms", t3_5 = "28bits", request_interval = "5ms" }
areas = [{ name = "d", table = "holding_registers", first = 0, last = 9, access = "rw", prefix = "D", base = 1, radix = "hex", width = 2, suffix = "H" }]
points = [
    { name = "a{n}", table = "holding_registers", address = 2, type = "uint32", count = 2, stride = 2, counted_from = 1, access = "r", block = 0, word_order = "low-first", byte_order = "low-first", unit = "s", scale = 0.1, offset = 1, decimals = 1, scale_from = "e", no_value = 5, texts = { 1 = "x" }, minimum = 0, maximum = 9, note = "n" },
    { name = "b", table = "holding_registers", address = 6, type = "flags", bits = { 0 = "x" }, default = 1 },
    { name = "c", table = "holding_registers", address = 7, type = "bit-field", first_channel = 1, channels = 4, channel = "DO" },
    { name = "s", table = "holding_registers", address = 8, type = "string", length = 1 },
    { name = "e", table = "holding_registers", address = 9, type = "int16" },
    { name = "u", table = "holding_registers", address = 0, units_from = "f", units = { 1 = "ms" } },
    { name = "o", table = "holding_registers", address = 1, type = "octets", after = "p" },
]
"""  # noqa: E501 - a line for each key that a profile has

ANYTHING: tuple[Any, ...] = (
    None, "", "x", "5ms", "{", -1, 0, 5, 70000, 10**30, -1.5, math.inf, math.nan, True,
    [], ["x"], [5], [[]], {}, {"x": "y"}, {"1": 2}, {"-1": "x"}, {"99999": "x"}, [{}],
)  # fmt: skip


def _places(node: Any, path: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    pairs = enumerate(node) if isinstance(node, list) else node.items()
    for key, value in list(pairs):
        yield (*path, key)
        if isinstance(value, list | dict):
            yield from _places(value, (*path, key))


def test_whatever_stands_at_any_key_is_taken_or_told_in_one_line() -> None:
    assert profile_from_json(json.dumps(tomllib.loads(ALL_KEYS)).encode(), "pump").name == "pump"
    told: list[str] = []
    taken: list[dict[str, Any]] = []
    for *path, last in _places(tomllib.loads(ALL_KEYS)):
        for value in ANYTHING:
            keys = tomllib.loads(ALL_KEYS)
            parent = keys
            for step in path:
                parent = parent[step]
            if value is not None:
                parent[last] = value
            else:
                del parent[last]
            try:
                profile_from_json(json.dumps(keys).encode(), "pump")
                taken.append(keys)
            except ProfileError as error:
                told.append(str(error))
    for line in told:
        assert re.fullmatch(r"pump: .+: .{10,}", line)
        # The words of this program, not of a library or of Python.
        assert re.search(r"`|<\w|\bNone\b|\bTrue\b|null", line) is None
    assert len(told) > 1000
    assert len(taken) > 100
    schema = Draft7Validator(profile_schema())
    for keys in taken:
        assert schema.is_valid(keys), keys


def test_every_key_is_among_those() -> None:
    names = set(re.findall(r"(\w+) =", ALL_KEYS))
    for part in (Profile, Area, FunctionRule, AnswerWord, Exceptions, Timing, Point):
        assert set(part.__struct_fields__) <= names
