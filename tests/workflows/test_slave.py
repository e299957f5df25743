"""Devices on links."""

from __future__ import annotations

import re
import socket
from typing import TYPE_CHECKING

import pytest

from mbtool.core import InputError, SerialFormat, TcpLink, UsageError, parse_link
from mbtool.core.link_spec import ANSWERED
from mbtool.devices import NamedTransaction, load_profile
from mbtool.master.links import open_master
from mbtool.modbus import rtu_adu
from mbtool.slave.families import make_device
from mbtool.slave.shells import SerialSlave, TcpSlave
from mbtool.workflows.shared.slave_monitor import SlaveMonitor
from mbtool.workflows.slave import Station, device_slave
from tests.sources.live_helpers import MASTER_TIMEOUT_NS

if TYPE_CHECKING:
    from pathlib import Path

    from mbtool.devices import Profile
    from mbtool.slave.device import DeviceResponder, RegisterImage

TOUCH = load_profile("idec-ft1a-touch")
LOOPBACK = parse_link("tcp:127.0.0.1:0")

READ = bytes.fromhex("03 0000 0001")  # read holding registers, address 0, quantity 1


def test_a_device_answers_as_its_unit_with_its_start_values(tmp_path: Path) -> None:
    image = tmp_path / "start.toml"
    image.write_text("HR400001 = 4660\n")
    shell = device_slave(TOUCH, LOOPBACK, 7, image)
    assert isinstance(shell, TcpSlave)
    with shell, open_master(TcpLink(shell.endpoint), MASTER_TIMEOUT_NS) as master:
        assert master.ask(7, READ) == bytes.fromhex("03 02 1234")


def test_other_units_get_no_answer() -> None:
    shell = device_slave(TOUCH, LOOPBACK, 7)
    assert isinstance(shell, TcpSlave)
    with shell, open_master(TcpLink(shell.endpoint), 200_000_000) as master:
        assert master.ask(8, READ) is None


@pytest.mark.parametrize("link", ["net:eth0", "tap:127.0.0.1:0=10.0.0.9", "rtu:x@auto"])
def test_a_link_that_no_slave_can_be_on_is_refused(link: str) -> None:
    with pytest.raises(UsageError, match=f"a slave needs {re.escape(ANSWERED)}"):
        device_slave(TOUCH, parse_link(link))


def test_a_link_with_two_ports_is_refused() -> None:
    with pytest.raises(UsageError, match="two ports can only listen; to answer, name one"):
        device_slave(TOUCH, parse_link("rtu:/dev/a,/dev/b@9600"))


@pytest.mark.parametrize(
    ("link", "quantity", "answered"), [("rtu", 26, True), ("ascii", 13, True), ("ascii", 14, False)]
)
def test_a_device_takes_on_its_line_what_it_takes_in_that_mode(
    monkeypatch: pytest.MonkeyPatch, link: str, quantity: int, answered: bool
) -> None:
    made: list[DeviceResponder] = []

    def keep(profile: Profile, image: RegisterImage) -> DeviceResponder:
        made.append(make_device(profile, image))
        return made[0]

    monkeypatch.setattr("mbtool.workflows.slave.make_device", keep)
    device_slave(load_profile("chino-lt830"), parse_link(f"{link}:/dev/absent@9600-8E1"))
    answer = made[0].respond(1, bytes([3, 0, 0xCD, 0, quantity]), 0)
    assert answer is not None
    assert (answer.pdu[0] == 3) == answered


def test_other_machines_are_let_in_only_if_allowed() -> None:
    with pytest.raises(UsageError, match=r"--allow 192\.168\.1\.0/24"):
        device_slave(TOUCH, parse_link("tcp:0.0.0.0:0")).start()


def test_start_values_that_cannot_be_read_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="absent"):
        device_slave(TOUCH, LOOPBACK, image_file=tmp_path / "absent")
    wrong = tmp_path / "wrong.toml"
    wrong.write_text("HR9 = 1\n")
    with pytest.raises(UsageError, match="HR9"):
        device_slave(TOUCH, LOOPBACK, image_file=wrong)


def test_nonvolatile_registers_survive_a_restart(tmp_path: Path) -> None:
    module, state = load_profile("fa3-at1m8x"), tmp_path / "state.toml"
    write, read = bytes.fromhex("06 00F5 0007"), bytes.fromhex("03 00F5 0001")
    for request in (write, read):
        shell = device_slave(module, LOOPBACK, state_file=state)
        assert isinstance(shell, TcpSlave)
        with shell, open_master(TcpLink(shell.endpoint), MASTER_TIMEOUT_NS) as master:
            answer = master.ask(0, request)
    assert answer == bytes.fromhex("03 02 0007")


def test_a_device_has_its_own_rules_for_connections() -> None:
    shell = device_slave(load_profile("fa3-at1m8x"), LOOPBACK)
    assert isinstance(shell, TcpSlave)
    assert shell.places == 2
    touch = device_slave(TOUCH, LOOPBACK)
    assert isinstance(touch, TcpSlave)
    assert touch.places == touch.bounds.connections


def test_requests_and_responses_reach_the_monitor() -> None:
    monitor = SlaveMonitor(TOUCH, LOOPBACK)
    shell = device_slave(TOUCH, LOOPBACK, 7, monitor=monitor)
    assert isinstance(shell, TcpSlave)
    with shell, open_master(TcpLink(shell.endpoint), MASTER_TIMEOUT_NS) as master:
        master.ask(7, READ)
    (transaction,) = monitor.records()
    assert isinstance(transaction, NamedTransaction)
    assert transaction.reference == "HR400001"


def test_several_devices_share_a_link_and_others_units_get_silence(tmp_path: Path) -> None:
    image = tmp_path / "other.toml"
    image.write_text("40001 = 7\n")
    others = {3: Station(load_profile("chino-lt830"), image), 4: Station(TOUCH)}
    shell = device_slave(TOUCH, LOOPBACK, 7, others=others)
    assert isinstance(shell, TcpSlave)
    with shell, open_master(TcpLink(shell.endpoint), 200_000_000) as master:
        assert master.ask(3, READ) == bytes.fromhex("03 02 0007")
        assert master.ask(7, READ) == master.ask(4, READ) == bytes.fromhex("03 02 0000")
        assert master.ask(5, READ) is None


def test_a_broadcast_on_a_line_reaches_every_device(tmp_path: Path) -> None:
    others = {3: Station(load_profile("chino-lt830"))}
    shell = device_slave(TOUCH, parse_link("rtu+tcp:127.0.0.1:0"), 7, others=others)
    assert isinstance(shell, TcpSlave)
    write = rtu_adu(0, bytes.fromhex("06 0000 1234"))
    with shell, socket.create_connection((shell.endpoint.host, shell.endpoint.port)) as master:
        for unit in (3, 7):
            master.sendall(write + rtu_adu(unit, READ))
            expected = rtu_adu(unit, bytes.fromhex("03 02 1234"))
            received = b""
            while len(received) < len(expected):
                received += master.recv(64)
            assert received == expected


@pytest.mark.parametrize(
    ("link", "name", "unit", "says"),
    [
        ("rtu:/dev/absent@9600", "chino-lt830", 100, "chino-lt830 can be unit 1 to 99"),
        (
            "rtu:/dev/absent@9600",
            "idec-ft1a-touch",
            0,
            "unit 0: on a serial line .* can be unit 1 to 247",
        ),
        ("rtu+tcp:127.0.0.1:0", "idec-ft1a-smartaxis", 248, "can be unit 1 to 247"),
    ],
)
def test_a_unit_that_a_device_cannot_be_is_refused(
    link: str, name: str, unit: int, says: str
) -> None:
    with pytest.raises(UsageError, match=says):
        device_slave(load_profile(name), parse_link(link), unit)
    with pytest.raises(UsageError, match=says):
        device_slave(TOUCH, parse_link(link), 9, others={unit: Station(load_profile(name))})


def test_a_line_has_the_silences_of_its_devices() -> None:
    shell = device_slave(load_profile("chino-lt830"), parse_link("rtu:/dev/absent@9600-8E1"), 2)
    assert isinstance(shell, SerialSlave)
    assert shell.link.format.t3_5_ns == 28 * 1_000_000_000 // 9600
    touch = device_slave(TOUCH, parse_link("rtu:/dev/absent@9600-8E1"))
    assert isinstance(touch, SerialSlave)
    assert touch.link.format == SerialFormat.parse("9600-8E1")


def test_values_that_move_and_faults_are_played(tmp_path: Path) -> None:
    image, fault = tmp_path / "start.toml", tmp_path / "fault.toml"
    image.write_text("HR400001 = { ramp = [7, 8], seconds = 10000 }\n")
    fault.write_text('[[faults]]\nkind = "exception"\ncode = 6\nnth = 2\ntimes = 1\n')
    shell = device_slave(TOUCH, LOOPBACK, 1, image, fault_file=fault)
    assert isinstance(shell, TcpSlave)
    with shell, open_master(TcpLink(shell.endpoint), MASTER_TIMEOUT_NS) as master:
        answers = [master.ask(1, READ) for _ in range(3)]
    assert answers == [bytes.fromhex(each) for each in ("03 02 0007", "83 06", "03 02 0007")]


def test_a_fault_that_the_link_cannot_have_is_refused(tmp_path: Path) -> None:
    fault = tmp_path / "fault.toml"
    fault.write_text('[[faults]]\nkind = "bad-crc"\n')
    with pytest.raises(UsageError, match="Modbus/TCP has no checksum"):
        device_slave(TOUCH, LOOPBACK, fault_file=fault)


def test_a_capture_that_is_not_there_is_refused(tmp_path: Path) -> None:
    image = tmp_path / "start.toml"
    image.write_text('HR400001 = { from = "absent.mcap" }\n')
    with pytest.raises(InputError, match=r"absent\.mcap"):
        device_slave(TOUCH, LOOPBACK, image_file=image)
