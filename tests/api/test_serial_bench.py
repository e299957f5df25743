"""A virtual line for Python programs."""

from __future__ import annotations

import pytest
from pymodbus import FramerType
from pymodbus.client import ModbusSerialClient

import mbtool
from tests.api.masters import PATIENCE_S


def test_a_slave_on_a_line_answers_an_independent_master() -> None:
    with (
        mbtool.line("rtu@115200-8N1") as line,
        mbtool.Slave("idec-ft1a-touch", line.link(1), image={"HR400001": 300}) as slave,
        ModbusSerialClient(
            line.ports[0], framer=FramerType.RTU, baudrate=115200, parity="N", timeout=PATIENCE_S
        ) as client,
    ):
        assert client.read_holding_registers(0, count=1, device_id=1).registers == [300]
        slave.assert_asked("HR400001", times=1)
        assert slave.link == f"rtu:{line.ports[1]}@115200-8N1"


def test_an_end_that_is_not_there_is_refused() -> None:
    with mbtool.line() as line, pytest.raises(mbtool.UsageError, match="the ends 0 to 1"):
        line.link(2)


def test_settings_that_no_line_has_are_refused() -> None:
    with pytest.raises(mbtool.UsageError, match="rtu@19200-8E1"):
        mbtool.line("19200-8E1")
    with pytest.raises(mbtool.UsageError, match="2 to 16 ends"):
        mbtool.line(ends=1)
