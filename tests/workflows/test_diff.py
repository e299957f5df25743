"""Two files compared by meaning."""

from __future__ import annotations

from pathlib import Path

import pytest

from mbtool.core import InputError, UsageError
from mbtool.devices import DifferenceKind as Kind
from mbtool.query.where import parse_where
from mbtool.workflows.diff import Comparison, DiffOptions, compare
from mbtool.workflows.shared.reading import ReadingOptions
from tests.workflows.evidence import capture_file, damaged_log

CAPTURES = Path(__file__).resolve().parents[2] / "captures"
SETUP = CAPTURES / "fa3-at1m8x-setup.mcap"
LINE = CAPTURES / "ft1a-touch-line.mcap"


def _compared(
    a: Path, b: Path, where: str = "unit >= 0", ignore: tuple[str, ...] = ()
) -> tuple[Comparison, list[str]]:
    remarks: list[str] = []
    options = DiffOptions(reading=ReadingOptions(), wanted=parse_where(where), ignore=ignore)
    return compare(str(a), str(b), options, remarks.append), remarks


@pytest.mark.parametrize("other", ["mcap", "pcap", "pcapng"])
def test_one_exchange_is_the_same_in_every_kind_of_file(other: str) -> None:
    compared, remarks = _compared(SETUP, SETUP.with_suffix(f".{other}"))
    assert (compared.differences, remarks, compared.is_whole) == ([], [], True)
    assert compared.a_transactions == compared.b_transactions > 0


def test_a_part_can_be_compared() -> None:
    whole, _ = _compared(LINE, LINE)
    part, _ = _compared(LINE, LINE, "function == 3")
    assert 0 < part.a_transactions < whole.a_transactions


def test_ranges_are_read_in_the_notation_of_a_logs_own_profiles() -> None:
    pair = (LINE, CAPTURES / "polling-with-exceptions.mcap")
    differ = {one.reference for one in _compared(*pair)[0].differences if one.kind is Kind.VALUE}
    left = _compared(*pair, ignore=("HR400001..400003", "C1"))[0].differences
    assert differ - {one.reference for one in left if one.kind is Kind.VALUE} == {
        "HR400001",
        "HR400002",
        "HR400003",
        "C1",
    }


def test_a_range_that_no_device_has_is_an_error() -> None:
    with pytest.raises(UsageError, match="'RWr99' is no range"):
        _compared(LINE, LINE, ignore=("RWr99",))


def test_a_damaged_log_is_compared_as_far_as_it_can_be_read(tmp_path: Path) -> None:
    whole, damaged = tmp_path / "a.pcap", damaged_log(tmp_path / "b.mcap", 1)
    whole.write_bytes(capture_file(2))
    compared, remarks = _compared(whole, damaged)
    assert compared.b_transactions == 2
    assert any(
        "; mbtool recover makes a whole log of it; comparing" in remark for remark in remarks
    )


def test_a_file_without_transactions_is_an_error(tmp_path: Path) -> None:
    empty = tmp_path / "a.pcap"
    empty.write_bytes(capture_file(0))
    with pytest.raises(InputError, match="no transaction to compare"):
        _compared(empty, LINE)


def test_captures_split_or_reordered_differently_are_equal(public_captures: Path) -> None:
    origin = next(public_captures.glob("nopnoplabs*/hist_*modbus.pcap"))
    compared, _ = _compared(origin, public_captures / "derived" / "reseg9_nopnop.pcap")
    assert compared.a_transactions == 234
    assert compared.differences == []


def test_a_fake_command_stands_out(public_captures: Path) -> None:
    folder = public_captures / "antoine-lemay__Modbus_dataset"
    usual = folder / "CnC_uploading_exe_modbus_6RTU_with_operate.pcap"
    faked = folder / "send_a_fake_command_modbus_6RTU_with_operate.pcap"
    asked = [
        (one.link, one.what, one.reference)
        for one in _compared(usual, faked)[0].differences
        if one.kind is Kind.REQUEST and one.a.count == 0
    ]
    assert ("192.168.1.101", "05 write coil", "coil 2") in asked
    assert {what for _, what, _ in asked} == {"05 write coil"}
