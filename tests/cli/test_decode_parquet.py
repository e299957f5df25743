"""decode --format parquet."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pyarrow.parquet as pq
import pytest

from mbtool.api.capture import open_capture
from mbtool.api.point_rows import PointRow
from mbtool.cli import printers
from mbtool.columns.schema import SCHEMA
from mbtool.logs.exports import csv_columns
from tests.columns.test_equality import poll
from tests.packets.building import Talk, pcap

if TYPE_CHECKING:
    from tests.cli.program import CommandLine

CAPTURES = Path(__file__).resolve().parents[2] / "captures"
SETUP = CAPTURES / "fa3-at1m8x-setup.pcap"


def rows_of(path: Path) -> list[dict[str, Any]]:
    """The rows of a Parquet file as jsonl has them."""
    return [
        {name: as_json(value) for name, value in row.items() if value is not None and value != []}
        for row in pq.read_table(path).drop_columns(["time"]).to_pylist()
    ]


def as_json(value: Any) -> Any:
    if isinstance(value, bytes):
        return value.hex()
    if isinstance(value, list) and value and isinstance(value[0], dict):
        return [
            {key: each for key, each in point.items() if each is not None and each is not False}
            for point in value
        ]
    return value


def lines_of(text: str) -> list[dict[str, Any]]:
    rows = [json.loads(line) for line in text.splitlines()]
    for row in rows:
        del row["time"]
        for name in ("request_values", "response_values"):
            if row.get(name) == []:
                del row[name]
    return rows


@pytest.mark.parametrize(
    "arguments",
    [
        (SETUP,),
        (SETUP, "--device", "all=fa3-at1m8x"),
        (SETUP, "--where", "function == 4"),
        (SETUP, "--limit", "3"),
        (CAPTURES / "fa3-at1m8x-setup.pcapng",),
        (CAPTURES / "ft1a-touch-line.mcap",),
        (CAPTURES / "polling-with-exceptions.mcap", "--sort", "latency"),
    ],
    ids=lambda one: " ".join(str(each).rpartition("/")[2] for each in one),
)
def test_parquet_has_the_rows_and_names_of_jsonl(
    arguments: tuple[object, ...], mbtool: CommandLine, tmp_path: Path
) -> None:
    lines = mbtool("decode", *arguments, "--format", "jsonl")
    said = mbtool("decode", *arguments, "-o", tmp_path / "a.parquet")
    assert said.code == 0
    assert said.out == ""
    assert rows_of(tmp_path / "a.parquet") == lines_of(lines.out)
    assert said.err.splitlines()[-1].startswith(lines.err.splitlines()[-1])


def test_the_columns_are_those_of_csv_and_the_schema_is_documented() -> None:
    assert set(SCHEMA.names) == set(csv_columns())
    page = (CAPTURES.parent / "docs" / "log-format.md").read_text()
    section = page.partition("| columns | type |")[2].partition("###")[0]
    assert [name for name in SCHEMA.names if f"`{name}`" not in section] == []


def test_a_capture_without_transactions_gives_an_empty_file_with_all_columns(
    mbtool: CommandLine, tmp_path: Path
) -> None:
    (tmp_path / "a.pcap").write_bytes(pcap(Talk().handshake()))
    assert mbtool("decode", tmp_path / "a.pcap", "-o", tmp_path / "a.parquet").code == 0
    assert pq.read_table(tmp_path / "a.parquet").num_rows == 0
    assert pq.read_schema(tmp_path / "a.parquet").names == SCHEMA.names


def test_a_cut_capture_gives_what_is_before_the_cut_and_exit_code_3(
    mbtool: CommandLine, tmp_path: Path
) -> None:
    talk = Talk()
    (tmp_path / "a.pcap").write_bytes(pcap([*talk.handshake(), *poll(talk, 10)])[:-5])
    said = mbtool("decode", tmp_path / "a.pcap", "-o", tmp_path / "a.parquet")
    assert said.code == 3
    assert "ends in the middle of a record, after 22 whole packets" in said.err
    assert pq.read_table(tmp_path / "a.parquet").num_rows == 10


def test_parquet_does_not_go_to_standard_output(mbtool: CommandLine) -> None:
    said = mbtool("decode", SETUP, "--format", "parquet")
    assert said.code == 2
    assert "--format parquet writes a file: decode FILE -o OUT.parquet" in said.err


def test_without_the_extra_one_line_says_how_to_install_it(
    mbtool: CommandLine, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(printers, "find_spec", lambda _: None)
    said = mbtool("decode", SETUP, "-o", tmp_path / "a.parquet")
    assert said.code == 2
    assert "--format parquet needs the extra mbtool[columns]: " in said.err
    assert len(said.err.splitlines()) == 1
    assert not (tmp_path / "a.parquet").exists()
    cluster = "--cluster", "tcp://127.0.0.1:1"
    said = mbtool("decode", SETUP, "--format", "parquet", "-o", f"{tmp_path}/a/", *cluster)
    assert "--cluster needs the extra mbtool[cluster]: " in said.err


def test_numpy_and_pyarrow_are_loaded_for_parquet_only() -> None:
    code = (
        "import sys; from mbtool.cli.main import run; "
        f"run(['decode', {str(SETUP)!r}, '--format', 'csv']); "
        "sys.exit(any(name in sys.modules for name in ('numpy', 'pyarrow')))"
    )
    assert (
        subprocess.run([sys.executable, "-c", code], capture_output=True, check=False).returncode
        == 0
    )


@pytest.mark.parametrize("arguments", [(), ("--device", "all=fa3-at1m8x")], ids=["plain", "device"])
def test_points_writes_a_second_file_with_a_row_for_each_value(
    arguments: tuple[str, ...], mbtool: CommandLine, tmp_path: Path
) -> None:
    transactions, values = tmp_path / "a.parquet", tmp_path / "points.parquet"
    said = mbtool("decode", SETUP, *arguments, "-o", transactions, "--points", values)
    assert said.code == 0
    capture = open_capture(SETUP, devices={"all": "fa3-at1m8x"} if arguments else None)
    expected = [tuple(one) for one in capture.points()]
    table = pq.read_table(values)
    assert [tuple(row.values()) for row in table.select(PointRow._fields).to_pylist()] == expected
    without = mbtool("decode", SETUP, *arguments, "-o", tmp_path / "b.parquet")
    assert without.code == 0
    assert pq.read_table(transactions).equals(pq.read_table(tmp_path / "b.parquet"))


def test_points_goes_with_parquet_only(mbtool: CommandLine, tmp_path: Path) -> None:
    said = mbtool("decode", SETUP, "-o", tmp_path / "a.csv", "--points", tmp_path / "b.parquet")
    assert said.code == 2
    assert "--points names a second file beside -o OUT.parquet" in said.err
    one = (tmp_path / "a.parquet", "--points", f"{tmp_path}/./a.parquet")
    assert "--points names a second file" in mbtool("decode", SETUP, "-o", *one).err
    assert list(tmp_path.iterdir()) == []
