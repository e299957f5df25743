"""Devices on links."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

import pytest

from mbtool.core import InputError, UsageError, parse_link
from mbtool.core.link_spec import ANSWERED
from mbtool.devices import load_profile
from mbtool.slave import TcpSlave
from mbtool.workflows.asking import TcpMaster
from mbtool.workflows.serving import device_slave

if TYPE_CHECKING:
    from pathlib import Path

TOUCH = load_profile("idec-ft1a-touch")
LOOPBACK = parse_link("tcp:127.0.0.1:0")

READ = bytes.fromhex("03 0000 0001")  # read holding registers, address 0, quantity 1


def test_a_device_answers_as_its_unit_with_its_start_values(tmp_path: Path) -> None:
    image = tmp_path / "start.toml"
    image.write_text("HR400001 = 4660\n")
    shell = device_slave(TOUCH, LOOPBACK, 7, image)
    assert isinstance(shell, TcpSlave)
    with shell, TcpMaster(shell.endpoint) as master:
        assert master.ask(7, READ) == bytes.fromhex("03 02 1234")


def test_other_units_get_no_answer(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("mbtool.workflows.asking.TIMEOUT_S", 0.2)
    shell = device_slave(TOUCH, LOOPBACK, 7)
    assert isinstance(shell, TcpSlave)
    with shell, TcpMaster(shell.endpoint) as master:
        assert master.ask(8, READ) is None


@pytest.mark.parametrize("link", ["net:eth0", "tap:127.0.0.1:0=10.0.0.9", "rtu:x@auto"])
def test_a_link_that_no_slave_can_be_on_is_refused(link: str) -> None:
    with pytest.raises(UsageError, match=f"a slave needs {re.escape(ANSWERED)}"):
        device_slave(TOUCH, parse_link(link))


def test_a_link_with_two_ports_is_refused() -> None:
    with pytest.raises(UsageError, match="two ports can only listen; to answer, name one"):
        device_slave(TOUCH, parse_link("rtu:/dev/a,/dev/b@9600"))


def test_others_are_let_in_only_with_leave() -> None:
    with pytest.raises(UsageError, match="--allow-remote"):
        device_slave(TOUCH, parse_link("tcp:0.0.0.0:0")).start()


def test_start_values_that_cannot_be_read_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="absent"):
        device_slave(TOUCH, LOOPBACK, image_file=tmp_path / "absent")
    wrong = tmp_path / "wrong.toml"
    wrong.write_text("HR9 = 1\n")
    with pytest.raises(UsageError, match="HR9"):
        device_slave(TOUCH, LOOPBACK, image_file=wrong)
