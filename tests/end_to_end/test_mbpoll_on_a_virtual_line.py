"""Debian's mbpoll as the master of an `mbtool slave`, with `mbtool sniff` on the same line."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import pytest

from mbtool.core import SerialFormat
from mbtool.sources.virtual_line import VirtualLine
from tests.end_to_end.programs import Program, answering, decoded, required, sniffing, wanted

if TYPE_CHECKING:
    from pathlib import Path

pytestmark = pytest.mark.peers

COILS, DISCRETE_INPUTS, INPUT_REGISTERS, HOLDING_REGISTERS = "0", "1", "3", "4"
"""mbpoll's names for the tables, after -t."""

IMAGE = """
I100001 = 1
I100003 = 1
IR300001 = 2310
IR304096 = 32767
HR400010 = 77
"""


@dataclass(frozen=True, kw_only=True)
class Step:
    """One run of mbpoll, and the transaction that the log must have of it."""

    options: tuple[str, ...]
    values: tuple[str, ...] = ()
    prints: str
    refused: bool = False
    logged: dict[str, Any] = field(default_factory=dict)


def read(table: str, first: int, count: int, *, shown: str, **logged: Any) -> Step:
    """mbpoll prints what it reads as one line for each reference."""
    options = ("-t", table, "-r", str(first), "-c", str(count))
    values = shown.split()
    prints = "".join(f"[{first + place}]: \t{value}\n" for place, value in enumerate(values))
    expected = {"response_values": [int(value) for value in values]}
    return Step(options=options, prints=prints, logged={"outcome": "ok", **expected, **logged})


def write(table: str, first: int, *values: int, **logged: Any) -> Step:
    """One value goes out as function 05 or 06, several as 0F or 10."""
    return Step(
        options=("-t", table, "-r", str(first)),
        values=tuple(map(str, values)),
        prints=f"Written {len(values)} references.",
        logged={"outcome": "ok", "request_values": list(values), **logged},
    )


def refused(step: Step, reason: str, exception: int) -> Step:
    outcome = {"outcome": "exception", "exception": exception}
    logged = {key: value for key, value in step.logged.items() if key != "response_values"}
    return Step(
        options=step.options,
        values=step.values,
        prints=reason,
        refused=True,
        logged={**logged, **outcome},
    )


STEPS = [
    # All four areas, as the image has them.
    read(COILS, 1, 3, shown="0 0 0", function=1, reference="C1..3"),
    read(DISCRETE_INPUTS, 1, 4, shown="1 0 1 0", function=2, reference="I100001..100004"),
    read(INPUT_REGISTERS, 1, 2, shown="2310 0", function=4, reference="IR300001..300002"),
    read(INPUT_REGISTERS, 4096, 1, shown="32767", function=4, reference="IR304096"),
    read(HOLDING_REGISTERS, 10, 1, shown="77", function=3, reference="HR400010"),
    # Writes, each read back.
    write(HOLDING_REGISTERS, 1, 4660, function=6, reference="HR400001"),
    write(HOLDING_REGISTERS, 2, 22136, 7, 32767, function=16, reference="HR400002..400004"),
    read(
        HOLDING_REGISTERS,
        1,
        4,
        shown="4660 22136 7 32767",
        function=3,
        reference="HR400001..400004",
    ),
    write(COILS, 1, 1, function=5, reference="C1"),
    write(COILS, 4096, 1, function=5, reference="C4096"),
    read(COILS, 1, 3, shown="1 0 0", function=1, reference="C1..3"),
    write(COILS, 1, 0, function=5, reference="C1"),
    read(COILS, 1, 1, shown="0", function=1, reference="C1"),
    # What the device refuses: it has no function 0F, and its areas end at 4096.
    refused(
        write(COILS, 1, 1, 0, 1, function=15, quantity=3, findings=["FT1A-F15"]),
        "Illegal function",
        1,
    ),
    read(COILS, 1, 3, shown="0 0 0", function=1, reference="C1..3"),
    refused(
        read(HOLDING_REGISTERS, 4096, 2, shown="", function=3, address=4095, quantity=2),
        "Illegal data address",
        2,
    ),
]


def test_all_areas_are_read_and_written_and_the_log_names_them(tmp_path: Path) -> None:
    play(SerialFormat(19200, 8, "E", 1), STEPS, tmp_path)


@pytest.mark.parametrize("baud", [1200, 115200])
def test_other_baud_rates(baud: int, tmp_path: Path) -> None:
    play(SerialFormat(baud, 8, "N", 2), STEPS[4:9], tmp_path)


def play(line_format: SerialFormat, steps: list[Step], folder: Path) -> None:
    """Take the steps one after another; what was heard of each must be in the log."""
    mbpoll = required("mbpoll", "mbpoll")
    image, log = folder / "image.toml", folder / "line.mcap"
    image.write_text(IMAGE)
    with VirtualLine(ends=3, format=line_format) as line:
        slave_link, sniffer_link = (f"rtu:{line.ports[end]}@{line_format}" for end in (0, 2))
        slave_command = ("slave", "idec-ft1a-touch", "--on", slave_link, "--image", str(image))
        sniff_options = (sniffer_link, "-w", str(log), "--device", "1=idec-ft1a-touch")
        with answering(*slave_command) as slave, sniffing(*sniff_options) as sniffer:
            # The line is 8N1 for mbpoll, as a pseudo-terminal may refuse parity.
            master = (mbpoll, "-m", "rtu", "-b", str(line_format.baud), "-P", "none", "-a", "1")
            for step in steps:
                command = (*master, "-1", *step.options, line.ports[1], *step.values)
                with Program(*command) as one:
                    assert one.wait() == int(step.refused), one.said.text
                    assert step.prints in one.printed.text + one.said.text
            sniffer.printed.take(len(steps))
            assert sniffer.interrupt() == 130
            assert slave.interrupt() == 130
    transactions = decoded(log, "--events", "trouble")
    expected = [step.logged for step in steps]
    assert [wanted(one, list(step)) for one, step in zip(transactions, expected, strict=True)] == (
        expected
    )
    assert {one["device"] for one in transactions} == {"idec-ft1a-touch"}
    assert transactions == decoded(log, "--events", "trouble", "--raw")
