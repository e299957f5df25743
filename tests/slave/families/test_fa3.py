"""What every FA3 module does beyond its registers: chapters 10.3 and 10.4."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from mbtool.devices import load_profile
from mbtool.modbus import Table
from mbtool.slave.device.connection_policy import Loss, Peer
from mbtool.slave.device.image import RegisterImage
from mbtool.slave.families import make_device
from mbtool.slave.families.fa3 import MAX_HISTORY, Fa3

if TYPE_CHECKING:
    from mbtool.slave.device.responder import DeviceResponder

# Chapter 10.4, read model name.
MODEL_CODES = {
    "fa3-th1m16xc": "0013",
    "fa3-th1m16y": "0014",
    "fa3-th1m16ye": "0015",
    "fa3-at1m8x": "0016",
    "fa3-at1m8y": "0017",
}
READ_ALARM = "04 0001 0001"


def _device(name: str = "fa3-at1m8x") -> tuple[DeviceResponder, Fa3]:
    profile = load_profile(name)
    device = make_device(profile, RegisterImage.of(profile))
    assert isinstance(device.behaviour, Fa3)
    return device, device.behaviour


def _ask(device: DeviceResponder, request: str, now_ns: int = 0) -> str | None:
    answer = device.respond(0, bytes.fromhex(request), now_ns)
    return None if answer is None else answer.pdu.hex(" ")


def _connect(behaviour: Fa3) -> Peer:
    peer = behaviour.connections.admit("10.0.0.1", 0).peer
    assert peer is not None
    return peer


@pytest.mark.parametrize(("name", "code"), MODEL_CODES.items())
def test_it_tells_its_model_code(name: str, code: str) -> None:
    assert _ask(_device(name)[0], "42 00") == f"42 {code[:2]} {code[2:]}"


@pytest.mark.parametrize("function", ["41", "42", "43", "44"])
@pytest.mark.parametrize("data", ["", "01", "00 00"])
def test_it_refuses_other_data_than_00(function: str, data: str) -> None:
    device, behaviour = _device()
    assert _ask(device, f"{function} {data}") == f"{int(function, 16) | 0x80:02x} 03"
    assert not behaviour.connections.changed


def test_an_alarm_stands_in_rwr1_until_the_error_is_cleared() -> None:
    device, behaviour = _device()
    behaviour.connections.lost(_connect(behaviour), Loss.SPLIT, 1)
    assert _ask(device, READ_ALARM) == "04 02 0e 40"
    behaviour.connections.lost(_connect(behaviour), Loss.NOT_ALIVE, 2)
    assert _ask(device, READ_ALARM) == "04 02 0e 30"
    assert _ask(device, "43 00") == "43 00"
    assert _ask(device, READ_ALARM) == "04 02 00 00"
    assert list(behaviour.history) == [0x0E40, 0x0E30]


def test_clearing_the_history_leaves_the_latest_alarm() -> None:
    device, behaviour = _device()
    behaviour.alarm(0x0E40)
    assert _ask(device, "44 00") == "44 00"
    assert _ask(device, READ_ALARM) == "04 02 0e 40"
    assert not behaviour.history


def test_the_history_is_bounded() -> None:
    _, behaviour = _device()
    for code in range(2 * MAX_HISTORY):
        behaviour.alarm(code)
    assert list(behaviour.history) == list(range(MAX_HISTORY, 2 * MAX_HISTORY))


def test_an_exception_is_no_alarm() -> None:
    device, _ = _device()
    assert _ask(device, "03 0010 0001") == "83 02"
    assert _ask(device, READ_ALARM) == "04 02 00 00"


def test_a_reset_answers_nothing_and_leaves_what_a_restart_leaves() -> None:
    profile = load_profile("fa3-th1m16y")
    image = RegisterImage.of(profile)
    image.set(Table.HOLDING_REGISTERS, 0x0200, [5])
    device = make_device(profile, image)
    assert isinstance(device.behaviour, Fa3)
    device.image.set(Table.INPUT_REGISTERS, 2, [77])
    device.behaviour.alarm(0x0E40)
    _ask(device, "05 0001 FF00")
    _ask(device, "06 0200 0006")
    _ask(device, "06 4FFF 0006")
    _ask(device, "06 00F5 0006")
    assert _ask(device, "41 00", 1_000_000_000) is None
    assert device.behaviour.connections.closed_until_ns == 3_000_000_000
    assert _ask(device, READ_ALARM) == "04 02 00 00"
    assert _ask(device, "01 0000 0010") == "01 02 00 00"
    assert _ask(device, "03 0200 0001") == "03 02 00 05"
    assert _ask(device, "03 4FFF 0001") == "03 02 00 00"
    assert _ask(device, "03 00F2 0004") == "03 08 02 58 00 0a 00 03 00 06"
    assert _ask(device, "04 0002 0001") == "04 02 00 4d"  # An input is the world outside's.


@pytest.mark.parametrize(
    ("request_", "keeps"),
    [
        ("06 00F0 0001", True),
        ("06 00F5 0001", True),
        ("10 00EF 0002 04 0000 0001", True),
        ("10 00F5 0002 04 0001 0000", True),
        ("06 00F5 001E", False),  # What it holds already.
        ("06 00EF 0001", False),
        ("06 00F6 0001", False),
        ("05 0009 FF00", False),
    ],
)
def test_it_keeps_00f0_to_00f5_when_they_change(request_: str, keeps: bool) -> None:
    device, behaviour = _device()
    kept: list[list[int]] = []
    ((table, span),) = behaviour.kept
    behaviour.keep = lambda: kept.append(device.image.get(table, span.start, len(span)))
    answer = _ask(device, request_)
    assert answer is not None
    assert not int(answer[:2], 16) & 0x80
    assert bool(kept) is keeps
    assert behaviour.connections.changed is keeps
    if keeps:
        assert kept[-1] == device.image.get(Table.HOLDING_REGISTERS, 0x00F0, 6)


@pytest.mark.parametrize("name", ["fa3-th1m16y", "fa3-th1m16ye"])
def test_digital_outputs_clear_when_the_last_connection_goes_and_follow_again(name: str) -> None:
    device, behaviour = _device(name)

    def on() -> list[str]:
        return [output.name for output in behaviour.outputs() if output.value]

    _ask(device, "0F 0000 0010 02 09 B0")
    assert on() == []
    first, second = _connect(behaviour), _connect(behaviour)
    assert on() == ["Y0", "Y3", "YC", "YD", "YF"]
    assert behaviour.outputs()[1].text == "off"
    behaviour.connections.lost(first, Loss.CLOSED, 1)
    assert len(on()) == 5
    behaviour.connections.lost(second, Loss.SPLIT, 2)
    assert on() == []
    assert _ask(device, "01 0000 0010") == "01 02 09 b0"
    _connect(behaviour)
    assert len(on()) == 5


def test_an_input_module_puts_nothing_out() -> None:
    assert _device("fa3-th1m16xc")[1].outputs() == ()
