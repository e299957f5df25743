"""mbtool test of slaves of other libraries: which deviations of each are named.

Each deviation of the lists was checked by hand: by the bytes of the case, the source of the library
and the section of the standard.
"""

from __future__ import annotations

import json
import os
import re
from contextlib import ExitStack
from typing import TYPE_CHECKING

import pytest

import mbtool as api
from tests.end_to_end.peers import SIZE, libmodbus_server, slave_of_another
from tests.end_to_end.programs import PATIENCE_S, mbtool
from tests.end_to_end.slaves_of_others import AREAS, Areas

if TYPE_CHECKING:
    from pathlib import Path

READS = {"coils": 1, "discrete_inputs": 2, "holding_registers": 3, "input_registers": 4}
_ALSO = {
    "pymodbus": ("07", "0B", "0C", "11", "18", "2B"),
    "modbus-tk": ("07",),
    "libmodbus": ("11",),
    "pymodbustcp": ("2B",),
}
"""By library: the functions that it answers beside the reads."""
_FUNCTION_80 = "got exception 01 illegal function with function 80"
# A request that pymodbus cannot decode gets an exception whose function is 00, not that of the
# request (V1.1b3 7).
_PYMODBUS = {
    **{
        f"{code:02X} {what}": _FUNCTION_80
        for code, limit in ((1, 2000), (2, 2000), (3, 125), (4, 125))
        for what in ("quantity 0", f"more than {limit}")
    },
    "function 14, which it lacks": _FUNCTION_80,
}
_UNKNOWN = tuple(f"function {code}, which it lacks" for code in ("41", "63", "6E"))
# pymodbus answers for units that it does not have, and for unit 0, with 04. What comes after bytes
# that are no request of its own is lost together with them.
_PYMODBUS_LINE = {
    **_PYMODBUS,
    "another unit": "got exception 04",
    "a read as broadcast": "got exception 04",
}
_LOST_ONCE = ", and the right one when it was asked again"
"""The end of a note: a busy machine loses a request of a serial line as well."""
_NO_ANSWER = "expected 1 value, got no answer"
_JOINED = {
    "a read behind an answer of another unit": _NO_ANSWER,
    "a read behind a stray byte": _NO_ANSWER,
}
DEVIATIONS: dict[str, dict[str, str]] = {
    "pymodbus-tcp": {
        **_PYMODBUS,
        **dict.fromkeys(_UNKNOWN, _FUNCTION_80),
        "two ADUs in one segment": "got 1111",
    },
    "pymodbus-rtu": {
        **_PYMODBUS_LINE,
        "a frame torn in two": "got 1 value",
        **dict.fromkeys(_UNKNOWN, "got no answer"),
        **_JOINED,
    },
    "pymodbus-ascii": {
        **_PYMODBUS_LINE,
        **dict.fromkeys(_UNKNOWN, _FUNCTION_80),
        "a read behind half a frame": _NO_ANSWER,
    },
    # It sends what it cannot decode back with the highest bit set, without a header.
    "modbus-tk-tcp": {
        "protocol id 1": "got protocol id 0001",
        "length 1": "got bytes that are no ADU: 81 04",
        "length 0": "got bytes that are no ADU: 81 04",
    },
    "modbus-tk-rtu": {},
    # A function without a route is an illegal address.
    "umodbus-tcp": {
        "02, which it lacks": "got exception 02",
        "protocol id 1": "got protocol id 0001",
    },
    "pymodbustcp-tcp": {
        f"function {code}, which it lacks": "got the end of the connection"
        for code in ("07", "0B", "0C", "11", "41", "63", "6E")
    },
    # It reads neither the protocol id nor the length, and refuses to answer what it lacks. Its
    # server, as its examples have it, serves one connection, and lets others wait.
    "libmodbus-tcp": {
        "function 07, which it lacks": "got the end of the connection",
        "protocol id 1": "got 1 value",
        "length 1": "got 1 value",
        "length 0": "got 1 value",
        "length FFFF": "got 1 value",
        "64 random bytes": "got exception 01 illegal function",
        "8 connections at once": "stays open, and a request on it got no answer",
    },
    "libmodbus-rtu": {
        **{
            f"function {code}, which it lacks": "got no answer" for code in ("07", "14", "18", "2B")
        },
        "a frame torn in two": "got 1 value",
        **_JOINED,
    },
}
SOMETIMES = {
    "modbus-tk-rtu": {"a frame torn in two"},
    "pymodbus-rtu": {"half a frame", "a frame torn in two", *_JOINED},
    "libmodbus-rtu": {"half a frame", "a frame torn in two", *_JOINED},
}
"""Cases in which the time between two bytes decides, which a busy machine stretches: half a frame
is lost with one request behind it or with two, and two pieces are read together or apart."""


SLOW = {"pymodbus-rtu", "libmodbus-rtu"}
"""These take one or two minutes, as a slave that lost a frame is deaf until a silence. They run
where MBTOOL_SLOW_PEERS is set."""


def profile_of(kind: str, areas: Areas) -> str:
    library = kind.rpartition("-")[0]
    codes = [f"{READS[table]:02X}" for table, some in areas.items() if some]
    lines = [
        'name = "other"', 'title = "A slave of another library"', 'vendor = "others"',
        'transports = ["rtu", "ascii", "tcp"]', 'source = "its documentation"', "[functions]",
    ]  # fmt: skip
    lines += [f"{code} = {{}}" for code in (*codes, *_ALSO.get(library, ()))]
    for table, some in areas.items():
        for first, last in some:
            lines += [
                "[[areas]]", f'name = "{table} {first}"', f'table = "{table}"',
                f"first = {first}", f"last = {last}", 'access = "r"',
            ]  # fmt: skip
    return "\n".join(lines)


def deviations(kind: str, folder: Path, *words: str) -> dict[str, str]:
    """The names and problems of the cases that did not pass."""
    profile = folder / "other.toml"
    with ExitStack() as stack:
        if kind == "libmodbus-rtu":
            line = stack.enter_context(api.line("rtu@19200-8N1"))
            stack.enter_context(libmodbus_server(folder, line.ports[1]))
            link = line.link(0)
        elif kind == "libmodbus-tcp":
            link = f"tcp:127.0.0.1:{stack.enter_context(libmodbus_server(folder))[0]}"
        else:
            link = stack.enter_context(slave_of_another(kind))
        areas = AREAS.get(kind) or {table: [(0, SIZE - 1)] for table in READS}
        profile.write_text(profile_of(kind, areas))
        with mbtool("test", str(profile), link, "--format", "jsonl", *words) as program:
            program.wait(10 * PATIENCE_S)
            rows = [json.loads(row) for row in program.printed.text.splitlines()]
    assert len(rows) > 90, program.said.text
    return {
        row["name"]: row["problem"]
        for row in rows
        if row["result"] != "passed" and not row["problem"].endswith(_LOST_ONCE)
    }


@pytest.mark.parametrize(
    "kind",
    [
        pytest.param(kind, marks=[pytest.mark.peers] if kind.startswith("libmodbus") else [])
        for kind in DEVIATIONS
        if kind not in SLOW or os.environ.get("MBTOOL_SLOW_PEERS")
    ],
)
def test_each_known_deviation_is_named_and_no_other(tmp_path: Path, kind: str) -> None:
    # On a busy machine a slave answers late. Those that are silent in many cases would take long.
    found = deviations(kind, tmp_path, "--timeout", "3" if kind in SLOW else "5")
    sometimes = SOMETIMES.get(kind, set())
    assert found.keys() - sometimes == DEVIATIONS[kind].keys() - sometimes
    for name, told in DEVIATIONS[kind].items():
        assert name not in found or re.search(re.escape(told), found[name]), name
