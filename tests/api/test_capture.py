"""Captures read from Python."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from collections.abc import Callable
from datetime import UTC, datetime
from pathlib import Path

import pytest

import mbtool
from mbtool.api import capture as capture_module
from mbtool.query.terms import NAMES

CAPTURES = Path(__file__).parents[2] / "captures"
LINE = CAPTURES / "ft1a-touch-line.mcap"
PACKETS = CAPTURES / "fa3-at1m8x-setup.pcap"
FA3: dict[int | str, str] = {"all": "fa3-at1m8x"}
Command = Callable[..., str]


@pytest.fixture
def mbtool_command() -> Command:
    def run(*words: object) -> str:
        command = [sys.executable, "-m", "mbtool", *map(str, words)]
        return subprocess.run(command, capture_output=True, text=True, check=False).stdout

    return run


def test_transactions_come_in_order_and_as_often_as_one_likes() -> None:
    capture = mbtool.open(LINE)
    first, again = list(capture.transactions()), list(capture)
    assert [one.reference for one in first[:2]] == ["HR400001..400004", "IR300001..300002"]
    assert first == again


def test_events_and_transactions_are_the_records() -> None:
    capture = mbtool.open(PACKETS)
    records = list(capture.records())
    assert [one for one in records if isinstance(one, mbtool.WireEvent)] == list(capture.events())
    assert len(records) == len(list(capture.events())) + len(list(capture.transactions()))
    assert next(capture.events()).kind is mbtool.EventKind.OPENED


def test_devices_give_names_and_values() -> None:
    capture = mbtool.open(PACKETS, devices=FA3)
    (code, *_) = capture.points()
    assert (code.name, code.value, code.text) == ("Model code", 22, "FA3-AT1M8X")


def test_where_chooses_transactions_and_keeps_events() -> None:
    capture = mbtool.open(PACKETS, where="function == 16")
    assert {one.function for one in capture} == {16}
    assert list(capture.events()) == list(mbtool.open(PACKETS).events())
    assert capture.to_arrow().num_rows == len(list(capture))


@pytest.mark.parametrize("devices", [None, FA3])
def test_the_table_has_the_transactions(devices: dict[int | str, str] | None) -> None:
    capture = mbtool.open(PACKETS, devices=devices)
    rows = capture.to_arrow().to_pylist()
    transactions = list(capture)
    assert [row["reference"] for row in rows] == [one.reference for one in transactions]
    assert [row["request_values"] for row in rows] == [one.request_values for one in transactions]


def test_the_table_has_the_columns_also_if_nothing_is_chosen() -> None:
    table = mbtool.open(LINE, where="unit == 200").to_arrow()
    assert (table.num_rows, table.column_names[0]) == (0, "link")


def test_a_table_without_its_packages_is_one_clear_error(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(capture_module, "find_spec", lambda _: None)
    with pytest.raises(mbtool.UsageError, match=r"needs the extra mbtool\[columns\]: "):
        mbtool.open(LINE).to_arrow()


@pytest.mark.parametrize("what", ["transactions", "points", "to_arrow"])
def test_a_cut_file_gives_what_is_there_and_then_raises(tmp_path: Path, what: str) -> None:
    cut = tmp_path / "cut.pcap"
    cut.write_bytes(PACKETS.read_bytes()[:-10])
    with pytest.raises(mbtool.CutError, match=r"cut\.pcap"):
        list(getattr(mbtool.open(cut), what)())
    whole = mbtool.open(cut, incomplete=True)
    assert len(list(getattr(whole, what)())) > 0
    assert any("cut.pcap" in one for one in whole.remarks)


def test_several_files_are_read_as_one(tmp_path: Path) -> None:
    other = tmp_path / "other.pcap"
    shutil.copy(PACKETS, other)
    both = mbtool.open(PACKETS, other)
    assert len(list(both)) == 2 * len(list(mbtool.open(PACKETS)))


def test_bytes_of_a_line_are_decoded_with_its_settings(tmp_path: Path) -> None:
    raw = tmp_path / "line.hex"
    raw.write_text("01 03 00 00 00 02 c4 0b 01 03 04 00 64 00 c8 ba 7a\n")
    (one,) = mbtool.open(raw, line="rtu@19200-8E1", devices={1: "idec-ft1a-touch"})
    assert one.response_values == [100, 200]


def test_a_file_without_modbus_says_so_in_its_remarks() -> None:
    capture = mbtool.open(PACKETS, ports=[1503])
    assert list(capture) == []
    assert any("no Modbus at TCP port 1503" in one for one in capture.remarks)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"devices": {5: "no-such"}}, "no-such"),
        ({"devices": {"nobody": "fa3-at1m8x"}}, "WHO is"),
        ({"devices": ["5=fa3-at1m8x"]}, "write a dictionary"),
        ({"where": "unit ="}, "unit ="),
        ({"line": "rtu:/dev/ttyUSB0@9600"}, "without a port"),
    ],
)
def test_a_wrong_argument_is_one_line(arguments: dict[str, object], message: str) -> None:
    with pytest.raises(mbtool.UsageError, match=message) as caught:
        mbtool.open(LINE, **arguments)  # type: ignore[arg-type]
    assert "\n" not in str(caught.value)


def test_a_transaction_has_the_names_of_filters() -> None:
    one = next(iter(mbtool.open(CAPTURES / "plant.pcap")))
    assert one.time == datetime(2026, 1, 1, microsecond=10_000, tzinfo=UTC)
    assert (one.master, one.slave, one.latency_ms) == ("10.0.0.1", "10.0.0.11", 3.146974)
    for name in ("time", "master", "slave", "latency_ms"):
        assert name in NAMES
    on_a_line = next(iter(mbtool.open(LINE)))
    assert (on_a_line.master, on_a_line.slave) == (None, None)


def test_the_repr_of_captures_and_transactions_is_one_line() -> None:
    capture = mbtool.open(CAPTURES / "plant.pcap", LINE)
    assert repr(capture) == f"mbtool.open({str(CAPTURES / 'plant.pcap')!r}, {str(LINE)!r})"
    for one in capture:
        assert "\n" not in repr(one)
        assert len(repr(one)) < 180
    assert repr(next(iter(mbtool.open(CAPTURES / "plant.pcap")))) == (
        "<NamedTransaction 2026-01-01 00:00:00.010000+00:00 10.0.0.11 unit 1 "
        "read holding registers holding 100..103 -> 1514 1500 0 1 ok 3.1 ms>"
    )


def test_a_notebook_shows_the_first_transactions_or_why_there_are_none(tmp_path: Path) -> None:
    shown = mbtool.open(CAPTURES / "plant.pcap")._repr_html_()
    assert shown.count("<tr>") == 12
    assert "-&gt; 1514, 1500, 0, 1" in shown
    cut = tmp_path / "<cut>.pcap"
    cut.write_bytes((CAPTURES / "plant.pcap").read_bytes()[:100])
    assert "&lt;cut&gt;.pcap: ends in the middle" in mbtool.open(cut)._repr_html_()


def test_stats_inventory_and_findings_are_those_of_the_commands(mbtool_command: Command) -> None:
    capture = mbtool.open(CAPTURES / "plant.pcap")
    assert capture.stats() == json.loads(mbtool_command("stats", CAPTURES / "plant.pcap", "--json"))
    of_command = mbtool_command("inventory", CAPTURES / "plant.pcap", "--format", "json")
    assert capture.inventory() == json.loads(of_command)
    of_check = mbtool_command("check", CAPTURES / "plant.pcap", "--format", "json")
    codes = [one["code"] for one in json.loads(of_check)["findings"]]
    assert [one.code for one in capture.findings()] == codes != []


def test_tables_of_polars_and_pandas_have_the_rows_of_arrow() -> None:
    for name in ("pandas", "polars"):
        pytest.importorskip(name, reason=f"{name} is not installed: pip install 'mbtool[data]'")
    capture = mbtool.open(PACKETS, devices=FA3)
    for points in (False, True):
        rows = capture.to_arrow(points=points).to_pylist()
        assert capture.to_polars(points=points).to_dicts() == rows
        assert len(capture.to_pandas(points=points)) == len(rows)
    values = [tuple(row[name] for name in mbtool.PointRow._fields) for row in rows]
    assert values == list(capture.points())
