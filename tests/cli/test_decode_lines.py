"""decode of large captures: read as arrays, and printed as without them."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from mbtool.views.transaction_table import SAMPLE
from mbtool.workflows.shared import reading_choice
from mbtool.workflows.shared.column_reading import ColumnReading
from tests.columns.disturbed_captures import disturbed
from tests.columns.sunspec_capture import sunspec_capture
from tests.columns.test_equality import poll
from tests.packets.building import Talk, pcap

if TYPE_CHECKING:
    from collections.abc import Iterator

    from mbtool.columns.column_decoder import DecodedBlock
    from tests.cli.program import CommandLine, Said

OWN = Path(__file__).resolve().parents[2] / "captures"
CAPTURES = sorted(path for kind in ("pcap", "pcapng") for path in OWN.glob(f"*.{kind}"))


@pytest.fixture
def in_arrays(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """Reads small files as arrays, too; a list with one entry for each block read so."""
    blocks: list[int] = []
    of_file = ColumnReading._file_blocks

    def counted(self: ColumnReading, path: str) -> Iterator[DecodedBlock]:
        for block in of_file(self, path):
            blocks.append(1)
            yield block

    monkeypatch.setattr(ColumnReading, "_file_blocks", counted)
    monkeypatch.setattr(reading_choice, "WORTH_BYTES", 0)
    return blocks


def row_by_row(mbtool: CommandLine, monkeypatch: pytest.MonkeyPatch, *arguments: object) -> Said:
    with monkeypatch.context() as patched:
        patched.setattr(reading_choice, "WORTH_BYTES", 1 << 40)
        return mbtool(*arguments)


@pytest.mark.parametrize("path", CAPTURES, ids=lambda one: one.name)
@pytest.mark.parametrize("format_", ["jsonl", "csv", "table"])
def test_the_captures_of_the_repository_are_printed_as_row_by_row(
    path: Path,
    format_: str,
    mbtool: CommandLine,
    monkeypatch: pytest.MonkeyPatch,
    in_arrays: list[int],
) -> None:
    arguments = ("decode", path, "--format", format_)
    assert mbtool(*arguments) == row_by_row(mbtool, monkeypatch, *arguments)


@pytest.mark.parametrize("name", ["a.jsonl", "a.csv", "a.txt"])
@pytest.mark.parametrize("cut", [0, 5])
def test_a_file_is_written_as_row_by_row(
    name: str,
    cut: int,
    mbtool: CommandLine,
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
    in_arrays: list[int],
) -> None:
    capture = disturbed(5)
    (tmp_path / "a.pcap").write_bytes(capture[: len(capture) - cut])
    arguments = ("decode", tmp_path / "a.pcap", "--overwrite", "-o", tmp_path / name)
    rows = row_by_row(mbtool, monkeypatch, *arguments)
    assert not in_arrays
    text = (tmp_path / name).read_bytes()
    assert mbtool(*arguments) == rows
    assert in_arrays
    assert (tmp_path / name).read_bytes() == text
    assert rows.code == (3 if cut else 0)


@pytest.mark.parametrize(
    "arguments",
    [
        ("--events", "all"),
        ("--where", "unit == 1"),
        ("--sort", "time"),
        ("--start", "1970-01-02"),
        ("--device", "all=fa3-at1m8x"),
        ("--device", "all=idec-ft1a-touch", "--where", "quantity == 3"),
    ],
)
@pytest.mark.parametrize("format_", ["jsonl", "table"])
def test_rows_that_are_chosen_or_sorted_come_from_arrays_too(
    arguments: tuple[str, ...],
    format_: str,
    mbtool: CommandLine,
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
    in_arrays: list[int],
) -> None:
    (tmp_path / "a.pcap").write_bytes(disturbed(5))
    line = ("decode", tmp_path / "a.pcap", "--format", format_, *arguments)
    rows = row_by_row(mbtool, monkeypatch, *line)
    assert not in_arrays
    assert mbtool(*line) == rows
    assert in_arrays


@pytest.mark.parametrize("color", ["", "1"])
def test_many_rows_of_a_table_are_printed_as_row_by_row(
    color: str,
    mbtool: CommandLine,
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
    in_arrays: list[int],
) -> None:
    if color:
        monkeypatch.setenv("FORCE_COLOR", color)
    talk = Talk()
    capture = pcap([*talk.handshake(), *poll(talk, SAMPLE + 50), *talk.goodbye()])
    (tmp_path / "a.pcap").write_bytes(capture)
    rows = row_by_row(mbtool, monkeypatch, "decode", tmp_path / "a.pcap")
    assert not in_arrays
    assert mbtool("decode", tmp_path / "a.pcap") == rows
    assert in_arrays
    assert ("\x1b[" in rows.out) is bool(color)


def test_the_first_rows_are_read_row_by_row(
    mbtool: CommandLine, tmp_path: Path, in_arrays: list[int]
) -> None:
    (tmp_path / "a.pcap").write_bytes(disturbed(5))
    assert mbtool("decode", tmp_path / "a.pcap", "--format", "jsonl", "--limit", "3").code == 0
    assert not in_arrays


def parts_of(capture: bytes, folder: Path, cut: int = 0) -> list[Path]:
    """Three files with the packets of a capture; `cut` bytes are missing at the end of the second.

    A fourth one has no packets.
    """
    places, at = [24], 24
    while at < len(capture):
        at += 16 + int.from_bytes(capture[at + 8 : at + 12], "little")
        places.append(at)
    third = len(places) // 3
    files = []
    for number, (begin, end) in enumerate(
        ((0, third), (third, 2 * third), (2 * third, -1), (0, 0))
    ):
        data = capture[places[begin] : places[end]]
        files.append(folder / f"{number}.pcap")
        files[-1].write_bytes(capture[:24] + (data[:-cut] if cut and number == 1 else data))
    return files


@pytest.mark.parametrize("order", [(0, 1, 2), (0, 3, 1, 2), (2, 0, 1), (0, 2, 1, 3), (1, 1)])
@pytest.mark.parametrize("cut", [0, 5])
@pytest.mark.parametrize("number", [3, 5])
def test_several_files_are_printed_as_row_by_row(
    order: tuple[int, ...],
    cut: int,
    number: int,
    mbtool: CommandLine,
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
    in_arrays: list[int],
) -> None:
    files = parts_of(disturbed(number), tmp_path, cut)
    for format_ in ("jsonl", "csv"):
        arguments = ("decode", *(files[one] for one in order), "--format", format_)
        rows = row_by_row(mbtool, monkeypatch, *arguments)
        assert not in_arrays
        assert mbtool(*arguments) == rows
        assert bool(in_arrays) is (len({*order}) == len(order))
        in_arrays.clear()


@pytest.mark.parametrize("format_", ["jsonl", "csv", "parquet", "table"])
@pytest.mark.parametrize("before", [0, 1, 20])
def test_a_sunspec_device_is_told_as_row_by_row(
    format_: str,
    before: int,
    mbtool: CommandLine,
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
    in_arrays: list[int],
) -> None:
    path = tmp_path / "meter.pcap"
    path.write_bytes(sunspec_capture(before))
    line = ("decode", path, "--format", "jsonl")
    rows = row_by_row(mbtool, monkeypatch, *line)
    assert "SunSpec models 1, 64900" in rows.err
    in_arrays.clear()
    output = tmp_path / f"out.{'txt' if format_ == 'table' else format_}"
    remarks = [
        one for one in mbtool("decode", path, "-o", output).err.splitlines() if "unit" in one
    ]
    assert in_arrays
    assert remarks == [one for one in rows.err.splitlines() if "unit" in one]
