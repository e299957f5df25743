"""decode of many captures into a folder: what is said."""

from __future__ import annotations

from contextlib import suppress
from typing import TYPE_CHECKING

import pyarrow.dataset as ds
import pytest

from mbtool.core import CutError
from mbtool.workflows.shared.column_reading import ColumnReading
from mbtool.workflows.shared.reading_options import ReadingOptions
from tests.workflows.rotated import make_sites

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from tests.cli.program import CommandLine


def test_broken_files_stop_no_other_and_are_told_again_without_being_read(
    mbtool: CommandLine, tmp_path: Path
) -> None:
    paths = make_sites(tmp_path / "in", 1)
    paths[2].write_bytes(b"no capture at all")
    paths[5].write_bytes(paths[5].read_bytes()[:-5])
    arguments = ("decode", paths[0].parent / "*", "--format", "parquet", "-o")
    said = mbtool(*arguments, f"{tmp_path}/out/")
    assert said.code == 3
    first, second, summary, error = said.err.splitlines()
    assert first.startswith(f"{paths[2]}: not read: a text file")
    assert second.startswith(f"{paths[5]}: read in part: ends in the middle of a record")
    assert summary.startswith("10 files, 10 decoded: ")
    assert error == "mbtool: 2 of 10 files could not be read to their ends"
    good = [path for path in paths if path != paths[2]]
    table = ds.dataset(tmp_path / "out", format="parquet").to_table()
    assert sorted(map(place_of, table.to_pylist())) == places_before_the_end(good)
    again = mbtool(*arguments, f"{tmp_path}/out/")
    assert again.err.splitlines()[:2] == [first, second]
    assert "10 files, 10 done before, 0 decoded" in again.err


def places_before_the_end(paths: Sequence[Path]) -> list[str]:
    """The places of the rows of a reading that ends with the error of a cut file."""
    rows = []
    with suppress(CutError):
        for batch in ColumnReading([*map(str, paths)], ReadingOptions()).batches():
            rows += batch.table.to_pylist()
    return sorted(map(place_of, rows))


def place_of(row: dict[str, object]) -> str:
    """Which packets a row comes from, and how it ended."""
    columns = ("file", "request_packet", "response_file", "response_packet", "outcome")
    return repr([row[column] for column in columns])


@pytest.mark.parametrize(
    ("options", "why"),
    [
        (("-o", "out/"), "go with --format parquet -o FOLDER/"),
        (("--format", "jsonl", "-o", "out/"), "go with --format parquet -o FOLDER/"),
        (("--format", "parquet", "--share", "0/2"), "go with --format parquet -o FOLDER/"),
        (("--format", "parquet", "-o", "out/", "--share", "2/2"), "I from 0 to N-1"),
        (("--format", "parquet", "-o", "out/", "--where", "unit == 1"), "--where: not with"),
        (("--format", "parquet", "-o", "nowhere://a/b"), "nowhere://a/b: "),
        (("--format", "parquet", "-o", "out/", "--cluster", "here"), "tcp://HOST:PORT"),
    ],
)
def test_a_wrong_command_line_is_told_in_one_line(
    options: tuple[str, ...],
    why: str,
    mbtool: CommandLine,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "a.pcap").write_bytes(b"")
    said = mbtool("decode", "a.pcap", *options)
    assert said.code == 2
    assert why in said.err
    assert len(said.err.splitlines()) == 1
    assert [one.name for one in tmp_path.iterdir()] == ["a.pcap"]


def test_a_pattern_that_fits_nothing_is_told(mbtool: CommandLine, tmp_path: Path) -> None:
    said = mbtool("decode", f"{tmp_path}/*.pcap", "--format", "parquet", "-o", f"{tmp_path}/out/")
    assert said.code == 3
    assert said.err == f"mbtool: {tmp_path}/*.pcap: there is no such file\n"


def test_a_directory_as_input_is_told(mbtool: CommandLine, tmp_path: Path) -> None:
    said = mbtool("decode", tmp_path, "--format", "parquet", "-o", f"{tmp_path}/out/")
    assert said.code == 3
    assert (
        said.err == f"mbtool: {tmp_path}: a directory; name captures in it: '{tmp_path}/*.pcap'\n"
    )


def test_an_output_that_cannot_be_written_is_told(mbtool: CommandLine, tmp_path: Path) -> None:
    make_sites(tmp_path / "in", 1, 300)
    (tmp_path / "out").write_text("a file")
    capture = tmp_path / "in" / "site-0" / "2026-11-22" / "cap-0.pcap"
    for folder in (f"{tmp_path}/out", f"{tmp_path}/out/in/it"):
        said = mbtool("decode", capture, "--format", "parquet", "-o", f"{folder}/")
        assert said.code == 2
        assert said.err == f"mbtool: {folder}: this folder cannot be made: Not a directory\n"
