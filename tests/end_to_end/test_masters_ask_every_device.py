"""Independent masters ask every built-in device, over every transport that both of them have.

What a master makes of an answer must be what the profile says: values where it may read, as they
were put there or written before, and the profile's exception where it may not: a function that the
device lacks, one more than its limit, the address behind an area, a write where one may only read.
docs/slave.md has the table.
"""

from __future__ import annotations

import re
import shlex
import subprocess
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

import pytest
from pymodbus import FramerType
from pymodbus.client import ModbusSerialClient, ModbusTcpClient
from pymodbus.exceptions import ModbusIOException
from pymodbus.pdu.file_message import ReadFifoQueueRequest

from mbtool.core import Endpoint, SerialFormat, SerialLink, TcpLink
from mbtool.devices import builtin_profiles, load_profile
from mbtool.modbus import FUNCTIONS, Table, Transport
from mbtool.slave.device import DeviceResponder, RegisterImage, units_on
from mbtool.slave.families import make_device
from mbtool.slave.shells import SerialSlave, TcpSlave
from mbtool.sources.virtual_line import VirtualLine
from mbtool.workflows.slave import Station, device_slave
from tests.end_to_end.programs import PATIENCE_S, required

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from mbtool.devices import Area, Profile

UNIT = 5
READS = (1, 2, 3, 4)
WRITES = ((5, 1), (6, 1), (15, 11), (16, 3))
"""Functions that write, and how many values each gets."""
MOST = 11
SETTLED = 16
"""An area of fewer addresses may be settings, which need not read back as they were written."""
STANDARD_LIMITS = {1: 2000, 2: 2000, 3: 125, 4: 125, 15: 1968, 16: 123}
"""A master of another make may refuse to ask for more."""
WORKED_OUT = {
    "fa3-at1m8x": {"remote input signal RX", "remote register RWr"},
    "wago-750": {
        "boot configuration, statistics and timeout",
        "internal bus cycle to MAC-ID, function 04",
        "blocks of information",
        "blocks of information, function 04",
    },
}
"""Areas where a device gives what it has worked out; there its own answer is what is expected."""

MBPOLL_TABLES = {1: "0", 2: "1", 4: "3", 3: "4", 5: "0", 15: "0", 6: "4", 16: "4"}
MBPOLL_REFUSALS = {"Illegal function": 1, "Illegal data address": 2, "Illegal data value": 3}

# On a busy machine a virtual line may pause inside a request for longer than 3.5 characters. The
# slave drops such a request, as real ones do, and the master asks again.
TRIES = 8
TRY_S = PATIENCE_S / TRIES

Reply = tuple[str, list[int]]
"""ok and the values that were read, or exception and its code."""


class Master(Protocol):
    most: int
    """How many bits or registers it asks for at once."""

    def ask(self, code: int, address: int, values: Sequence[int]) -> Reply:
        """Read (the one value is the quantity) or write."""


@dataclass(frozen=True)
class Place:
    """Where a device answers, for a master of another make."""

    transport: Transport
    port: int = 0
    path: str = ""


def _devices(*leaving_out: Transport) -> list[tuple[str, Transport]]:
    """Each device on each transport; where it has RTU, over TCP too."""
    return [
        (name, transport)
        for name in builtin_profiles()
        for own in load_profile(name).transports
        for transport in ([own, Transport.RTU_TCP] if own is Transport.RTU else [own])
        if transport not in leaving_out
    ]


@pytest.mark.parametrize(("name", "transport"), _devices())
def test_pymodbus_agrees(name: str, transport: Transport) -> None:
    with _slave(name, transport) as (device, place), _pymodbus(place) as client:
        master = _Pymodbus(client)
        profile = load_profile(name).with_limits_of(transport)
        _ask_all(device, profile, master)
        fifo = client.execute(False, ReadFifoQueueRequest(address=0, dev_id=UNIT))
        assert fifo.exception_code == profile.exceptions.function
        if transport is not Transport.TCP:
            _broadcast(device, profile, client)


def test_several_devices_share_a_line() -> None:
    """Each answers as its unit, a broadcast reaches all, and another's unit gets silence."""
    touch, lt830 = load_profile("idec-ft1a-touch"), load_profile("chino-lt830")
    line = SerialFormat(115200, 8, "N", 1)
    with VirtualLine(ends=2, format=line) as virtual:
        link = SerialLink(virtual.ports[0], line)
        place = Place(Transport.RTU, path=virtual.ports[1])
        others = {3: Station(lt830)}
        with device_slave(touch, link, UNIT, others=others), _pymodbus(place) as client:
            assert client.write_register(0, 11, device_id=UNIT).registers == [11]
            assert client.read_holding_registers(0, count=27, device_id=3).exception_code == 3
            assert client.read_holding_registers(0, count=27, device_id=UNIT).registers[0] == 11
            client.write_register(0, 4711, device_id=0, no_response_expected=True)
            for unit in (3, UNIT):
                read = client.read_holding_registers(0, count=2, device_id=unit)
                assert read.registers == [4711, 0]
            client.comm_params.timeout_connect = 0.3 / TRIES
            with pytest.raises(ModbusIOException):
                client.read_holding_registers(0, count=1, device_id=4)


@pytest.mark.peers
@pytest.mark.parametrize(("name", "transport"), _devices(Transport.ASCII, Transport.RTU_TCP))
def test_libmodbus_agrees(name: str, transport: Transport, tmp_path: Path) -> None:
    program = _libmodbus(tmp_path)
    with _slave(name, transport) as (device, place):
        to = ["tcp", str(place.port)] if place.port else ["rtu", place.path, "115200"]
        with subprocess.Popen(
            [program, *to, str(UNIT)], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        ) as child:
            _ask_all(device, load_profile(name), _Libmodbus(child))
            assert child.stdin is not None
            child.stdin.close()


@pytest.mark.peers
@pytest.mark.parametrize(("name", "transport"), _devices(Transport.ASCII, Transport.RTU_TCP))
def test_mbpoll_agrees(name: str, transport: Transport) -> None:
    mbpoll = required("mbpoll", "mbpoll")
    with _slave(name, transport) as (device, place):
        _ask_all(device, load_profile(name), _Mbpoll(mbpoll, place))


def _ask_all(device: DeviceResponder, profile: Profile, master: Master) -> None:
    """Read the ends of each area, write and read back, and ask for what is not allowed."""
    asked = 0
    written: dict[str, int] = {}
    address = ("exception", [profile.exceptions.address])
    for area in profile.areas:
        reads = [code for code in READS if _table(code) is area.table and profile.rule(code)]
        for code in reads if area.access.allows(writing=False) else ():
            for first, quantity in _ends(area, profile, code):
                assert master.ask(code, first, [quantity]) == _expected(
                    device, profile, area, code, range(first, first + quantity), written
                )
                asked += 1
        if area.access.allows(writing=True) and area.last - area.first >= SETTLED:
            asked += _write_all(device, profile, master, area, written)
        for code in (5, 6):
            here = range(area.first, area.first + 1)
            if _table(code) is area.table and not profile.allows(area.table, here, writing=True):
                assert master.ask(code, area.first, [1]) == address
                asked += 1
        beyond = area.last + 1
        if reads and not profile.allows(area.table, range(beyond, beyond + 1)):
            assert master.ask(reads[0], beyond, [1]) == address
            asked += 1
    assert asked >= len(profile.areas)
    _ask_too_much(profile, master)


def _ask_too_much(profile: Profile, master: Master) -> None:
    """Functions that the device lacks, and one more than it takes at once."""
    for code in (*READS, 5, 6, 15, 16):
        rule = profile.rule(code)
        if rule is None:
            refused = ("exception", [profile.exceptions.function])
            assert master.ask(code, 0, [1, 1] if code > 6 else [1]) == refused
        elif (
            rule.limit is not None
            and not rule.doubtful
            and rule.limit < min(STANDARD_LIMITS[code], master.most)
        ):
            refused = ("exception", [profile.value_exception(code)])
            count = rule.limit + 1
            assert master.ask(code, 0, [count] if code in READS else [1] * count) == refused


def _broadcast(device: DeviceResponder, profile: Profile, client: Any) -> None:
    """A write to unit 0 is done and not answered: the next answer is that to the next request."""
    area = next(one for one in profile.areas if one.table is _table(6) and one.access == "rw")
    client.write_register(area.first, 4711, device_id=0, no_response_expected=True)
    read = client.read_holding_registers(area.first, count=1, device_id=UNIT)
    assert read.registers == [4711]
    assert device.image.get(area.table, area.first) == [4711]


def _write_all(
    device: DeviceResponder, profile: Profile, master: Master, area: Area, written: dict[str, int]
) -> int:
    """Write the ends of an area; `written` gets what was, by its reference."""
    asked = 0
    for code, most in WRITES:
        rule = profile.rule(code)
        if rule is None or _table(code) is not area.table:
            continue
        count = min(most, rule.limit or most)
        for first in (area.first, area.last - count + 1):
            values = [
                (first * 3 + at) % (2 if area.table.is_bits else 0x8000) for at in range(count)
            ]
            assert master.ask(code, first, values) == ("ok", [])
            if area.access.allows(writing=False):
                assert device.image.get(area.table, first, count) == values
            references = [area.reference(address) for address in range(first, first + count)]
            written.update(zip(references, values, strict=True))
            asked += 1
    return asked


def _ends(area: Area, profile: Profile, code: int) -> set[tuple[int, int]]:
    rule = profile.rule(code)
    assert rule is not None
    quantity = min(area.last - area.first + 1, MOST, rule.limit or MOST)
    return {(area.first, quantity), (area.last - quantity + 1, quantity)}


def _expected(
    device: DeviceResponder,
    profile: Profile,
    area: Area,
    code: int,
    span: range,
    written: dict[str, int],
) -> Reply:
    if area.name in WORKED_OUT.get(profile.name, ()):
        return _own(device, code, span.start, len(span))
    return "ok", [
        written.get(area.reference(address), _stands(profile, area, address)) for address in span
    ]


def _stands(profile: Profile, area: Area, address: int) -> int:
    """What an address of an area holds before anyone writes there."""
    if area.last - area.first >= SETTLED:
        return _filled(area, address)
    for point in profile.points:
        in_area = point.block is None and point.default is not None
        if in_area and area.table in _shared(profile, point.table) and address in point.addresses:
            return point.default or 0
    return 0


def _shared(profile: Profile, table: Table) -> set[Table]:
    """The tables that are one with a table."""
    return {table, Table.INPUT_REGISTERS} if profile.behaviour == "wago" else {table}


def _filled(area: Area, address: int) -> int:
    return (address * 31 + 7) % (2 if area.table.is_bits else 0x8000)


def _own(device: DeviceResponder, code: int, address: int, quantity: int) -> Reply:
    table = _table(code)
    pdu = bytes([code]) + address.to_bytes(2, "big") + quantity.to_bytes(2, "big")
    answer = device.respond(UNIT, pdu, 0)
    assert answer is not None
    data = answer.pdu[2:]
    if answer.pdu[0] & 0x80:
        return "exception", [answer.pdu[1]]
    if table.is_bits:
        return "ok", [data[at // 8] >> at % 8 & 1 for at in range(quantity)]
    return "ok", [int.from_bytes(data[at : at + 2], "big") for at in range(0, 2 * quantity, 2)]


def _table(code: int) -> Table:
    table = FUNCTIONS[code].table
    assert table is not None
    return table


@contextmanager
def _slave(name: str, transport: Transport) -> Iterator[tuple[DeviceResponder, Place]]:
    profile = load_profile(name).with_limits_of(transport)
    device = make_device(profile, RegisterImage.of(profile))
    for area in profile.areas:
        if area.last - area.first >= SETTLED:
            ends = (range(area.first, area.first + MOST), range(area.last - MOST, area.last + 1))
            for address in (each for end in ends for each in end):
                device.image.set(area.table, address, [_filled(area, address)])
    if transport in (Transport.TCP, Transport.RTU_TCP):
        link = TcpLink(Endpoint("127.0.0.1", 0), rtu=transport is Transport.RTU_TCP)
        units = units_on(link, profile, UNIT, device)
        with TcpSlave(link, units, rules=device.behaviour.rules) as tcp:
            yield device, Place(transport, port=tcp.endpoint.port)
        return
    line = SerialFormat(115200, 8, "N", 1)
    with VirtualLine(ends=2, format=line) as virtual:
        serial = SerialLink(virtual.ports[0], line, ascii=transport is Transport.ASCII)
        with SerialSlave(serial, units_on(serial, profile, UNIT, device)):
            yield device, Place(transport, path=virtual.ports[1])


@contextmanager
def _pymodbus(place: Place) -> Iterator[Any]:
    client: Any
    if place.port:
        framer = FramerType.SOCKET if place.transport is Transport.TCP else FramerType.RTU
        client = ModbusTcpClient(
            "127.0.0.1", port=place.port, framer=framer, timeout=TRY_S, retries=TRIES - 1
        )
    else:
        framer = FramerType.ASCII if place.transport is Transport.ASCII else FramerType.RTU
        client = ModbusSerialClient(
            place.path, framer=framer, baudrate=115200, timeout=TRY_S, retries=TRIES - 1
        )
    assert client.connect()
    try:
        yield client
    finally:
        client.close()


class _Pymodbus:
    most = 2000

    def __init__(self, client: Any) -> None:
        self._client = client

    def ask(self, code: int, address: int, values: Sequence[int]) -> Reply:
        client, to = self._client, {"device_id": UNIT}
        match code:
            case 1:
                reply = client.read_coils(address, count=values[0], **to)
            case 2:
                reply = client.read_discrete_inputs(address, count=values[0], **to)
            case 3:
                reply = client.read_holding_registers(address, count=values[0], **to)
            case 4:
                reply = client.read_input_registers(address, count=values[0], **to)
            case 5:
                reply = client.write_coil(address, bool(values[0]), **to)
            case 6:
                reply = client.write_register(address, values[0], **to)
            case 15:
                reply = client.write_coils(address, [bool(one) for one in values], **to)
            case _:
                reply = client.write_registers(address, list(values), **to)
        if reply.isError():
            return "exception", [reply.exception_code]
        if code not in READS:
            return "ok", []
        return "ok", [int(one) for one in (reply.bits if code < 3 else reply.registers)][
            : values[0]
        ]


class _Libmodbus:
    most = 2000

    def __init__(self, child: subprocess.Popen[str]) -> None:
        self._child = child

    def ask(self, code: int, address: int, values: Sequence[int]) -> Reply:
        assert self._child.stdin is not None
        assert self._child.stdout is not None
        self._child.stdin.write(f"{code} {address} {' '.join(map(str, values))}\n")
        self._child.stdin.flush()
        word, *numbers = self._child.stdout.readline().split()
        return word, [int(each) for each in numbers]


class _Mbpoll:
    """One process for each request."""

    most = 125
    attempts = 3
    """libmodbus gives up on a response that pauses for 0.5 s, as one does on a busy machine."""

    def __init__(self, program: str, place: Place) -> None:
        if place.port:
            self._command = [program, "-m", "tcp", "-p", str(place.port), "-a", str(UNIT)]
            self._to = "127.0.0.1"
        else:
            self._command = [program, "-m", "rtu", "-b", "115200", "-P", "none", "-a", str(UNIT)]
            self._to = place.path

    def ask(self, code: int, address: int, values: Sequence[int]) -> Reply:
        table = ["-0", "-1", "-o", "10", "-t", MBPOLL_TABLES[code], "-r", str(address)]
        count = ["-c", str(values[0])] if code in READS else []
        written = [] if code in READS else [str(each) for each in values]
        command = [*self._command, *table, *count, self._to, *written]
        for _ in range(self.attempts):
            done = subprocess.run(
                command, capture_output=True, text=True, timeout=PATIENCE_S, check=False
            )
            if "timed out" not in done.stderr:
                break
        for reason, exception in MBPOLL_REFUSALS.items():
            if reason in done.stderr + done.stdout:
                return "exception", [exception]
        assert done.returncode == 0, done.stderr
        return "ok", [int(each) for each in re.findall(r"^\[\d+\]:\s+(\d+)", done.stdout, re.M)]


def _libmodbus(folder: Path) -> str:
    compiler, finder = required("gcc", "gcc"), required("pkg-config", "pkg-config")
    found = subprocess.run(
        [finder, "--cflags", "--libs", "libmodbus"], capture_output=True, text=True, check=False
    )
    if found.returncode:
        pytest.skip("needs libmodbus: apt install libmodbus-dev")
    source, program = Path(__file__).with_name("libmodbus_master.c"), folder / "libmodbus_master"
    flags = ["-Wall", "-Wextra", "-Werror", *shlex.split(found.stdout)]
    subprocess.run([compiler, source, "-o", program, *flags], check=True)
    return str(program)
