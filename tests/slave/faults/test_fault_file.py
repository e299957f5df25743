from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from mbtool.core import InputError, UsageError
from mbtool.devices import Span, load_profile
from mbtool.modbus import Table
from mbtool.slave.faults.fault_file import MAX_FILE_BYTES, FaultFile
from mbtool.slave.faults.faults import Fault, FaultCondition, FaultKind

if TYPE_CHECKING:
    from pathlib import Path

FT1A = load_profile("idec-ft1a-touch")


def _read(tmp_path: Path, text: str) -> FaultFile:
    path = tmp_path / "faults.toml"
    path.write_text(text)
    return FaultFile(path, [FT1A])


def _faults(tmp_path: Path, text: str) -> list[Fault]:
    return _read(tmp_path, f"[[faults]]\n{text}").faults


def test_reads_a_fault_with_all_that_it_matches(tmp_path: Path) -> None:
    file = _read(
        tmp_path,
        """
        seed = 7

        [[faults]]
        kind = "exception"
        code = 6
        functions = [3, 0x10]
        units = 1
        registers = "HR400001..400010"
        seconds = [10, 20.5]
        nth = 3
        every = 5
        times = 2
        probability = 0.5

        [[faults]]
        kind = "close"
        """,
    )
    assert file.seed == 7
    assert file.faults == [
        Fault(
            kind=FaultKind.EXCEPTION,
            code=6,
            match=FaultCondition(
                units=frozenset({1}),
                functions=frozenset({3, 16}),
                span=Span(Table.HOLDING_REGISTERS, 0, 9),
                from_ns=10_000_000_000,
                until_ns=20_500_000_000,
                nth=3,
                every=5,
                times=2,
                probability=0.5,
            ),
        ),
        Fault(kind=FaultKind.CLOSE),
    ]


@pytest.mark.parametrize(
    ("text", "fault"),
    [
        ('kind = "delay"\nms = 2.5', Fault(kind=FaultKind.DELAY, delay_ns=2_500_000)),
        ('kind = "no-answer"', Fault(kind=FaultKind.NO_ANSWER)),
        ('kind = "exception"', Fault(kind=FaultKind.EXCEPTION, code=4)),
        ('kind = "wrong-unit"\nby = 3', Fault(kind=FaultKind.WRONG_UNIT, by=3)),
        ('kind = "wrong-id"', Fault(kind=FaultKind.WRONG_ID, by=1)),
        ('kind = "truncated"\nbytes = 2', Fault(kind=FaultKind.TRUNCATED, count=2)),
        ('kind = "bad-crc"', Fault(kind=FaultKind.BAD_CRC)),
        (
            'kind = "extra-bytes"\nbytes = "00 FF"',
            Fault(kind=FaultKind.EXTRA_BYTES, extra=b"\x00\xff"),
        ),
        (
            'kind = "split"\npieces = 3\ngap_ms = 5',
            Fault(kind=FaultKind.SPLIT, count=3, delay_ns=5_000_000),
        ),
        ('kind = "reset"', Fault(kind=FaultKind.RESET)),
        ('kind = "stuck"', Fault(kind=FaultKind.STUCK)),
        ('kind = "offset"\nby = -5', Fault(kind=FaultKind.OFFSET, by=-5)),
    ],
)
def test_reads_each_kind(tmp_path: Path, text: str, fault: Fault) -> None:
    assert _faults(tmp_path, text) == [fault]


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("", "fault 1: kind: is missing; write one of delay, no-answer, exception"),
        ('kind = "slow"', "fault 1: kind: 'slow' is none; write one of delay"),
        ('kind = "delay"', "fault 1: ms: is missing; write a number from 0 to 86400000"),
        ('kind = "delay"\nms = -1', "fault 1: ms: -1: write a number from 0"),
        ('kind = "delay"\nms = nan', "fault 1: ms: nan: write a number from 0"),
        ('kind = "delay"\nmss = 1', "fault 1: mss: not a key that belongs here; did you mean ms?"),
        ('kind = "close"\nms = 1', "fault 1: ms: not a key that belongs here; "),
        ('kind = "exception"\ncode = 256', "fault 1: code: 256: write a number from 1 to 255"),
        ('kind = "exception"\ncode = true', "fault 1: code: True: write a number"),
        ('kind = "wrong-unit"\nby = 0', "fault 1: by: 0: write a number from 1"),
        ('kind = "wrong-unit"\nby = 256', "fault 1: by: 256: write a number from 1 to 255"),
        ('kind = "extra-bytes"\nbytes = "0"', "fault 1: bytes: '0': write hexadecimal bytes"),
        ('kind = "split"\npieces = 1', "fault 1: pieces: 1: write a number from 2 to 260"),
        ('kind = "close"\nunits = []', "fault 1: units: []: list numbers from 0 to 255"),
        ('kind = "close"\nunits = ["a"]', "fault 1: units: ['a']: list numbers from 0 to 255"),
        ('kind = "close"\nfunctions = 200', "fault 1: functions: 200: list numbers from 1 to 127"),
        ('kind = "close"\nregisters = 5', "fault 1: registers: 5: write a text"),
        ('kind = "close"\nregisters = "RWr1"', "fault 1: registers: 'RWr1' is no range"),
        ('kind = "close"\nseconds = [5, 5]', "fault 1: seconds: [5, 5]: write from and until"),
        ('kind = "close"\nseconds = 5', "fault 1: seconds: 5: write from and until"),
        ('kind = "close"\nnth = 0', "fault 1: nth: 0: write a number from 1"),
        ('kind = "close"\nprobability = 1.5', "fault 1: probability: 1.5: write a number from 0"),
        ('kind = "close"\n[[faults]]\nkind = "x"', "fault 2: kind: 'x' is none"),
    ],
)
def test_what_is_wrong_is_told_with_what_would_be_right(
    tmp_path: Path, text: str, problem: str
) -> None:
    with pytest.raises(UsageError) as told:
        _faults(tmp_path, text)
    assert f"faults.toml: {problem}" in str(told.value)


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("", r"no \[\[faults\]\]"),
        ("faults = 5", r"no \[\[faults\]\]"),
        ("faults = [5]", r"fault 1: write \[\[faults\]\] above"),
        ("seed = 1.5\n[[faults]]\nkind='close'", "seed: 1.5: write a number"),
        ("sead = 1\n[[faults]]\nkind='close'", "sead: not a key that belongs here; did you mean"),
    ],
)
def test_a_file_without_faults_is_wrong(tmp_path: Path, text: str, problem: str) -> None:
    with pytest.raises(UsageError, match=problem):
        _read(tmp_path, text)


@pytest.mark.parametrize("text", ["kind =", "x" * (MAX_FILE_BYTES + 1), "\x00"])
def test_what_is_no_toml_is_wrong(tmp_path: Path, text: str) -> None:
    with pytest.raises(UsageError):
        _read(tmp_path, text)


def test_a_file_that_is_not_there_cannot_be_read(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="cannot be read"):
        FaultFile(tmp_path / "none.toml")
