"""Captures read from Python."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

import mbtool
from mbtool.api import capture as capture_module

CAPTURES = Path(__file__).parents[2] / "captures"
LINE = CAPTURES / "ft1a-touch-line.mcap"
PACKETS = CAPTURES / "fa3-at1m8x-setup.pcap"
FA3: dict[int | str, str] = {"all": "fa3-at1m8x"}


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
    assert capture.table().num_rows == len(list(capture))


@pytest.mark.parametrize("devices", [None, FA3])
def test_the_table_has_the_transactions(devices: dict[int | str, str] | None) -> None:
    capture = mbtool.open(PACKETS, devices=devices)
    rows = capture.table().to_pylist()
    transactions = list(capture)
    assert [row["reference"] for row in rows] == [one.reference for one in transactions]
    assert [row["request_values"] for row in rows] == [one.request_values for one in transactions]


def test_the_table_has_the_columns_also_if_nothing_is_chosen() -> None:
    table = mbtool.open(LINE, where="unit == 200").table()
    assert (table.num_rows, table.column_names[0]) == (0, "link")


def test_a_table_without_its_packages_is_one_clear_error(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(capture_module, "find_spec", lambda _: None)
    with pytest.raises(mbtool.UsageError, match=r"needs the extra mbtool\[columns\]: "):
        mbtool.open(LINE).table()


@pytest.mark.parametrize("what", ["transactions", "points", "table"])
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
