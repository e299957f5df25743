from __future__ import annotations

import pytest

from mbtool.devices.block_reads import can_be_read
from mbtool.devices.loading import load_profile
from mbtool.devices.profile_checks import request_findings
from mbtool.modbus import Table
from tests.devices.transactions import transaction

WAGO = load_profile("wago-750")


@pytest.mark.parametrize("table", [Table.HOLDING_REGISTERS, Table.INPUT_REGISTERS])
@pytest.mark.parametrize(
    ("first", "quantity", "can"),
    [
        (0x2020, 16, True),
        (0x2020, 1, True),
        (0x2020, 17, False),  # More than the short description.
        (0x2023, 32, True),
        (0x2033, 63, True),
        (0x2033, 64, False),
        (0x2030, 65, True),
        (0x2024, 1, False),
        (0x202F, 2, False),
        (0x2034, 1, False),
        (0x2040, 1, False),  # A command.
        (0x2050, 1, False),
        (0x1029, 9, True),  # The statistics, and what stands alone beside them.
        (0x102A, 1, True),
        (0x102B, 1, False),
        (0x1030, 2, True),
        (0x2000, 9, True),
        (0x0000, 125, True),
    ],
)
def test_blocks_are_read_from_their_beginning(
    table: Table, first: int, quantity: int, can: bool
) -> None:
    assert can_be_read(WAGO, table, range(first, first + quantity)) is can
    function = 3 if table is Table.HOLDING_REGISTERS else 4
    asked = transaction(function, first, quantity=quantity)
    assert list(request_findings(WAGO, asked)) == ([] if can else [f"WAGO-A{function}"])


def test_without_blocks_only_areas_limit_reads() -> None:
    touch = load_profile("idec-ft1a-touch")
    assert can_be_read(touch, Table.HOLDING_REGISTERS, range(4096))
    assert not can_be_read(touch, Table.HOLDING_REGISTERS, range(4097))


def test_reads_of_17h_respect_blocks() -> None:
    asked = transaction(0x17, 0x2024, quantity=1, write_address=0, request_values=[1])
    assert list(request_findings(WAGO, asked)) == ["WAGO-A23"]
