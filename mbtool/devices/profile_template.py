"""The profile that `mbtool devices new` writes: an example to edit, with comments."""

# _TEXT is exactly the file that users get, with comments for them, apart from the names that are
# filled in. A test loads it as a profile.

from __future__ import annotations

import re

_TEXT = """\
# A profile contains what a device's manual says about the device's addresses. This one describes a
# pump that does not exist; replace its contents by those of your manual. Look at it with
#
#     mbtool devices {file}
#     mbtool decode capture.mcap --device 5={file}
#
# docs/devices.md of mbtool explains every key, and "mbtool devices schema" gives the JSON Schema
# with which an editor completes and checks them. Numbers may be hexadecimal: 0x0102.

name = {name}  # letters, digits, - _ .
title = "Feed pump 7"  # the full name, for readers
vendor = "Maker"
transports = ["rtu"]  # of rtu, ascii, tcp, rtu-tcp
source = "operating instructions, edition 3, chapter 9"

# The functions that it has, by code in two hexadecimal digits. "limit" is the largest quantity, if
# the manual states one; otherwise the standard's limit applies.

[functions]
03 = {{ limit = 16 }}
06 = {{}}
10 = {{ limit = 16 }}
01 = {{}}
05 = {{}}

# The exception codes that it gives: for a function that it lacks, for a wrong address, for a wrong
# quantity or value; and all codes in its manual. Without this section: 1, 2 and 3.

[exceptions]
function = 1
address = 2
value = 3
documented = [1, 2, 3, 0x11]
texts = {{ 0x11 = "pump is running" }}

# Areas: the ranges of addresses that it has. "first" and "last" are addresses on the wire, from 0.
# "base" is the manual's number for address 0, and "prefix" the text before the number: with
# base = 40001, address 10 is written 40011; with prefix = "D" and base = 0, it is written D10.

[[areas]]
name = "data register"
table = "holding_registers"  # or input_registers, coils, discrete_inputs
first = 0
last = 99
access = "rw"  # or "r", or "w"
base = 40001

[[areas]]
name = "command"
table = "coils"
first = 0
last = 7
access = "rw"
prefix = "C"
base = 1

# Points: the values that the manual names. Registers without a point are shown as numbers.

[[points]]
name = "Speed"
table = "holding_registers"
address = 10  # 40011
scale = 0.1  # the register holds tenths
unit = "rpm"
minimum = 0
maximum = 3000
access = "r"  # a master may only read it

[[points]]
name = "Temperature"
table = "holding_registers"
address = 11
type = "int16"  # uint16 without this key
offset = -40  # the register holds 0 at -40 degC
unit = "degC"

[[points]]
name = "State"
table = "holding_registers"
address = 12
texts = {{ 0 = "stopped", 1 = "running", 2 = "fault" }}

[[points]]
name = "Alarms"
table = "holding_registers"
address = 13
type = "flags"  # a name for each bit
bits = {{ 0 = "too hot", 1 = "no water", 15 = "service due" }}

[[points]]
name = "Flow"
table = "holding_registers"
address = 14
type = "float32"  # takes two registers; others: int32, uint32, bcd32, float64, int64, uint64
word_order = "low-first"  # CDAB: the second register is the high one
unit = "m3/h"
decimals = 2

[[points]]
name = "Serial number"
table = "holding_registers"
address = 16
type = "string"
length = 8  # registers, two characters in each

[[points]]
name = "Bearing {{n}} temperature"  # a series: 1 to 4
table = "holding_registers"
address = 30
count = 4
stride = 2  # addresses from one to the next
scale = 0.1
unit = "degC"

[[points]]
name = "Run"
table = "coils"
address = 0  # C1
type = "bit"
texts = {{ 0 = "off", 1 = "on" }}

# Silences on the line, if those in the manual differ from the standard's:
#
# [timing]
# t3_5 = "28bits"

# Notes for readers, for example on contradictions in the manual:
#
# notes = ["..."]  # at the top, beside name and title
"""


def starting_profile(file: str, name: str) -> str:
    """The text of the example profile, with its name and the name of its file filled in."""
    return _TEXT.format(file=re.sub(r"[^\x20-\x7e]", "?", file), name=f'"{name}"')


def name_for(file: str) -> str:
    """A valid profile name made from a file name: `Pump 7.toml` becomes pump-7."""
    stem = re.split(r"[/\\]", file)[-1]
    stem = stem.rpartition(".")[0] or stem
    return re.sub(r"[^a-z0-9._-]+", "-", stem.lower()).strip("-._") or "device"
