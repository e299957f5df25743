"""Slaves in a Python program, asked over raw sockets."""

from __future__ import annotations

import socket
from pathlib import Path

import pytest

import mbtool
from mbtool.api import observed_shell
from mbtool.modbus import rtu_adu
from tests.api.masters import PATIENCE_S, READ_TWO, master_of, send
from tests.api.masters import ask as ask_unit

CAPTURES = Path(__file__).parents[2] / "captures"
LINE = CAPTURES / "ft1a-touch-line.mcap"


def touch(**options: object) -> mbtool.Slave:
    return mbtool.Slave("idec-ft1a-touch", **options)  # type: ignore[arg-type]


def test_a_slave_answers_with_its_values_and_knows_what_it_was_asked() -> None:
    with touch(image={"HR400001": [100, 200]}) as slave, master_of(slave) as ask:
        assert ask(READ_TWO) == bytes.fromhex("03 04 0064 00c8")
        (one,) = slave.asked
        assert (one.reference, one.response_values) == ("HR400001..400002", [100, 200])
        assert one.link == f"127.0.0.1:{slave.port}"
    assert slave.asked == [one]


def test_values_can_be_read_and_set_while_it_answers() -> None:
    with touch() as slave, master_of(slave) as ask:
        slave["HR400002"] = 7
        slave["C1"] = 1
        assert ask(READ_TWO) == bytes.fromhex("03 04 0000 0007")
        assert ask("01 0000 0001") == bytes.fromhex("01 01 01")
        ask("06 0000 1234")
        assert slave["HR400001"] == 0x1234


PUMP = """
name = "pump"
title = "Pump"
vendor = "Maker"
transports = ["tcp"]
source = "made for this test"
[functions]
03 = {}
06 = {}
10 = {}
[[areas]]
name = "data"
table = "holding_registers"
first = 0
last = 20
access = "rw"
prefix = "D"
base = 0
[[points]]
name = "Setpoint"
table = "holding_registers"
address = 0
scale = 0.1
unit = "degC"
[[points]]
name = "Flow"
table = "holding_registers"
address = 4
type = "float32"
[[points]]
name = "Maker's text"
table = "holding_registers"
address = 6
type = "string"
length = 3
"""


def pump(folder: Path) -> mbtool.Slave:
    file = folder / "pump.toml"
    file.write_text(PUMP)
    return mbtool.Slave(file)


@pytest.mark.parametrize(("name", "value", "registers"), [
    ("Setpoint", 21.5, [215]),
    ("Flow", 1.5, [16320, 0]),
    ("Maker's text", "AB12", [0x4142, 0x3132, 0]),
])  # fmt: skip
def test_a_named_point_is_in_its_unit_and_its_registers_are_raw(
    tmp_path: Path, name: str, value: float | str, registers: list[int]
) -> None:
    with pump(tmp_path) as slave:
        slave[name] = value
        assert slave[name] == value
        assert slave.raw[name] == registers


def test_a_written_point_is_asserted_in_its_unit(tmp_path: Path) -> None:
    with pump(tmp_path) as slave, master_of(slave) as ask:
        ask("06 0000 00d7")
        ask("10 0004 0002 04 3fc0 0000")
        slave.assert_asked("Setpoint", written=21.5, times=1)
        slave.assert_asked("D0", written=215, times=1)
        slave.assert_asked("Flow", written=1.5, times=1)
        with pytest.raises(AssertionError, match=r"Setpoint with 22.0 written: asked never"):
            slave.assert_asked("Setpoint", written=22.0)
        with pytest.raises(mbtool.UsageError, match=r"Setpoint: written=99999"):
            slave.assert_asked("Setpoint", written=99999.0)
        with pytest.raises(mbtool.UsageError, match="no profile has a point there"):
            slave.assert_asked("holding 12", written=1.5)


def test_a_value_that_does_not_fit_is_refused() -> None:
    with touch() as slave:
        with pytest.raises(mbtool.UsageError, match="HR400001"):
            slave["HR400001"] = 70_000
        with pytest.raises(mbtool.UsageError, match="for `image` only"):
            slave["HR400001"] = {"ramp": [0, 9], "seconds": 1}
        with pytest.raises(mbtool.UsageError, match="XY1"):
            slave["XY1"]


def test_an_image_is_a_file_as_well(tmp_path: Path) -> None:
    image = tmp_path / "start.toml"
    image.write_text("HR400001 = 5\n")
    with touch(image=image) as slave:
        assert slave["HR400001"] == 5
    with pytest.raises(mbtool.UsageError, match=r"^image: .*HX1"):
        touch(image={"HX1": 5})


def test_assert_asked_counts_requests_for_a_register() -> None:
    with touch() as slave, master_of(slave) as ask:
        ask(READ_TWO)
        ask("06 0003 0009")
        assert len(slave.assert_asked("HR400001")) == 1
        slave.assert_asked("HR400002", times=1)
        slave.assert_asked("HR400001..400004", 2)
        slave.assert_asked("holding 3", function=6, written=9)
        slave.assert_asked("HR400003", times=0)
        slave.assert_asked("C4", times=0)
        slave.assert_asked("HR400001", times=0, unit=2)


def test_assert_asked_says_what_came_instead() -> None:
    with touch() as slave, master_of(slave) as ask:
        with pytest.raises(AssertionError, match="no request came at all"):
            slave.assert_asked("HR400001")
        ask(READ_TWO)
        with pytest.raises(AssertionError) as caught:
            slave.assert_asked("HR400001", times=3)
        first, second = str(caught.value).splitlines()
        assert first == "HR400001: asked once, not 3 times. What was asked:"
        assert second.endswith("unit 1  03 read HR400001..400002 -> 0, 0")
        with pytest.raises(AssertionError, match=r"HR400004 with 9 written: asked never"):
            slave.assert_asked("HR400004", written=9)
        with pytest.raises(mbtool.UsageError, match=r"^'HX1' is no register or bit of idec-ft1a"):
            slave.assert_asked("HX1")


def test_a_slave_forgets() -> None:
    with touch() as slave, master_of(slave) as ask:
        ask(READ_TWO)
        slave.forget()
        assert slave.asked == []
        ask(READ_TWO)
        assert len(slave.asked) == 1


def test_only_the_last_requests_are_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(observed_shell, "MAX_KEPT", 2)
    with touch() as slave, master_of(slave) as ask:
        for _ in range(3):
            ask(READ_TWO)
            assert 1 <= len(slave.asked) <= 2


def test_faults_come_and_go() -> None:
    with touch() as slave, master_of(slave) as ask:
        slave.fault("exception", code=6, times=1, registers="HR400001")
        assert ask(READ_TWO) == bytes.fromhex("83 06")
        assert ask(READ_TWO) == bytes.fromhex("03 04 0000 0000")
        slave.fault("exception")
        slave.clear_faults()
        assert ask(READ_TWO)[0] == 3


def test_faults_may_be_given_at_the_start(tmp_path: Path) -> None:
    file = tmp_path / "busy.toml"
    file.write_text('[[faults]]\nkind = "exception"\ncode = 6\n')
    for faults in (file, [{"kind": "exception", "code": 6}]):
        with touch(faults=faults) as slave, master_of(slave) as ask:
            assert ask(READ_TWO) == bytes.fromhex("83 06")


@pytest.mark.parametrize(
    ("kind", "message"),
    [("broken", "kind: 'broken' is none; write one of delay"), ("bad-crc", "has no checksum")],
)
def test_a_wrong_fault_is_refused(kind: str, message: str) -> None:
    with pytest.raises(mbtool.UsageError, match=f"^faults: fault 1: .*{message}"):
        touch().fault(kind)


def test_a_request_without_response_is_unanswered() -> None:
    with touch() as slave, socket.create_connection((slave.host, slave.port), PATIENCE_S) as master:
        slave.fault("close")
        slave.fault("no-answer")
        send(master, 1, bytes.fromhex(READ_TWO))
        assert master.recv(1) == b""  # The slave closes the connection without a response.
        assert [one.reference for one in slave.unanswered] == ["HR400001..400002"]


def test_a_request_to_an_absent_unit_is_unanswered() -> None:
    with touch() as slave, socket.create_connection((slave.host, slave.port), PATIENCE_S) as master:
        send(master, 9, bytes.fromhex(READ_TWO))
        assert ask_unit(master, 1, bytes.fromhex(READ_TWO))[0] == 3
        assert [one.unit for one in slave.asked] == [9, 1]
        assert [one.unit for one in slave.unanswered] == [9]


def test_several_devices_answer_on_one_link() -> None:
    with (
        touch(others={2: "fa3-at1m8x"}, on="rtu+tcp:127.0.0.1:0") as slave,
        socket.create_connection((slave.host, slave.port), PATIENCE_S) as master,
    ):
        for unit, name in ((1, "idec-ft1a-touch"), (2, "fa3-at1m8x")):
            master.sendall(rtu_adu(unit, bytes.fromhex("03 0000 0001")))
            assert master.recv(1) == bytes([unit])
            master.recv(100)
            assert slave.asked[-1].device == name
    with pytest.raises(mbtool.UsageError, match="unit 1 is the first device"):
        touch(others={1: "idec-ft1a-touch"})


def test_a_serial_line_has_no_host(tmp_path: Path) -> None:
    slave = touch(on=f"rtu:{tmp_path / 'port'}@19200-8E1")
    with pytest.raises(mbtool.LinkError, match="a serial line has no TCP host and port"):
        _ = slave.host
    with pytest.raises(mbtool.LinkError, match="port"), slave:
        pass


def test_a_log_of_what_was_asked_can_be_read_and_played(tmp_path: Path) -> None:
    log = tmp_path / "asked.mcap"
    with touch(image={"HR400001": 5}) as slave, master_of(slave) as ask:
        ask(READ_TWO)
        slave.save_log(log)
        slave.save_log(log)
    (one,) = mbtool.open(log)
    assert one.response_values == [5, 0]
    with mbtool.Replay(log) as replay, master_of(replay) as ask:
        assert ask(READ_TWO) == bytes.fromhex("03 04 0005 0000")


def test_a_recording_answers_and_knows_what_it_was_asked() -> None:
    with mbtool.Replay(LINE, match="image", latency="none") as replay, master_of(replay) as ask:
        assert replay.units == [1]
        assert ask("03 0000 0004") == bytes.fromhex("03 08 0064 00c8 012c 0190")
        replay.assert_asked("HR400001..400004", times=1)
        replay.fault("exception", code=4, registers="HR400001")
        assert ask("03 0000 0001") == bytes.fromhex("83 04")


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"match": "exact"}, "match 'exact': write one of auto, sequence, key, time, image"),
        ({"on_miss": "no"}, "on_miss 'no': write one of image"),
        ({"on_end": "no"}, "on_end 'no': write one of last"),
        ({"start": 5, "end": 5}, "start 5, end 5: write seconds"),
        ({"start": 1e6}, "in the part"),
        ({"speed": 0}, "speed 0: write a number above 0"),
        ({"latency": "slow"}, "latency 'slow'"),
        ({"speed": None, "match": "time"}, "goes by the recording's clock"),
        ({"on": "net:eth0"}, "a slave needs"),
    ],
)
def test_a_wrong_option_of_a_recording_is_refused(options: dict[str, object], message: str) -> None:
    with pytest.raises(mbtool.MbtoolError, match=message):
        mbtool.Replay(LINE, **options)  # type: ignore[arg-type]


def test_a_named_input_is_set_although_no_master_may_write_it() -> None:
    with mbtool.Slave("idec-ft1a-smartaxis") as slave, master_of(slave) as ask:
        slave["T5 contact"] = 1
        assert slave["T5 contact"] == 1
        assert ask("02 03ed 0001") == bytes.fromhex("02 01 01")  # discrete input 1005
        (one,) = slave.asked
        assert [point.name for point in one.points] == ["T5 contact"]
