"""Transactions as tidy rows; the bytes are decoded as a TCP stream."""

from __future__ import annotations

from datetime import UTC, datetime

import pytest

import mbtool
from mbtool.api.point_rows import PointRow, point_rows
from mbtool.devices import load_profile

FA3 = load_profile("fa3-at1m8x")


def rows(request: str, response: str, *, device: bool = False) -> list[PointRow]:
    decoder = mbtool.Decoder("tcp", devices={"all": FA3} if device else None)
    records = decoder.feed(adu(request), 1_000, direction="request")
    records += decoder.feed(adu(response), 2_000, direction="response")
    (one,) = (each for each in records if not isinstance(each, mbtool.WireEvent))
    return list(point_rows(one, FA3 if device else None))


def adu(pdu: str) -> bytes:
    data = bytes.fromhex(pdu)
    return bytes.fromhex("0007 0000") + (len(data) + 1).to_bytes(2) + b"\x01" + data


def test_each_register_that_is_read_is_a_row_named_by_its_reference() -> None:
    one, two = rows("03 006b 0002", "03 04 0001 ffff")
    assert one == PointRow(
        time_ns=2_000,
        link="slave",
        slave="slave:502",
        unit=1,
        device=None,
        reference="holding 107",
        name="holding 107",
        value=1,
        text="1",
        unit_of_measure=None,
        written=False,
        master="master:0",
    )
    assert one.time == datetime(1970, 1, 1, 0, 0, 0, 2, UTC)
    assert (two.reference, two.value) == ("holding 108", 0xFFFF)


def test_a_value_that_is_written_says_so() -> None:
    assert [(one.reference, one.value, one.written) for one in rows("05 0003 ff00", "05 0003 ff00")
            ] == [("coil 3", 1, True)]  # fmt: skip


def test_function_17h_gives_what_it_reads_and_what_it_writes() -> None:
    found = rows("17 0000 0001 0010 0001 02 1234", "17 02 0042")
    assert [(one.reference, one.value, one.written) for one in found] == [
        ("holding 0", 0x42, False),
        ("holding 16", 0x1234, True),
    ]


def test_a_device_gives_its_points_in_its_words() -> None:
    (one,) = rows("10 0102 0001 02 005c", "10 0102 0001", device=True)
    assert (one.device, one.reference, one.written) == ("fa3-at1m8x", "0102H", True)
    assert one.text != "92"


@pytest.mark.parametrize(
    ("request_pdu", "response"),
    [
        ("06 0000 0001", "86 02"),  # an exception response
        ("16 0004 00f2 0025", "16 0004 00f2 0025"),  # a mask write has no values
        ("08 0000 a537", "08 0000 a537"),  # diagnostics
    ],
)
def test_what_has_no_confirmed_value_gives_no_row(request_pdu: str, response: str) -> None:
    assert rows(request_pdu, response) == []
