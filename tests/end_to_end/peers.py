"""Servers and clients of pymodbus and libmodbus, and a client that knows nothing but bytes."""

from __future__ import annotations

import asyncio
import select
import shlex
import socket
import struct
import subprocess
import sys
from contextlib import ExitStack, contextmanager
from pathlib import Path
from threading import Thread
from typing import TYPE_CHECKING, Any

import pytest
from pymodbus import FramerType
from pymodbus.client import ModbusSerialClient, ModbusTcpClient, ModbusUdpClient
from pymodbus.server import ModbusTcpServer, ModbusTlsServer, ModbusUdpServer
from pymodbus.simulator import DataType, SimData, SimDevice

import mbtool as api
from tests.end_to_end.programs import PATIENCE_S, Program, required
from tests.end_to_end.slaves_of_others import BAUD as SLAVE_BAUD
from tests.end_to_end.slaves_of_others import NEEDS, library_of

if TYPE_CHECKING:
    import ssl
    from collections.abc import Callable, Iterator

    from pymodbus.client.base import ModbusBaseSyncClient
    from pymodbus.pdu import ModbusPDU

UNIT = 1
SIZE = 200
"""How many addresses each table of a server has."""

INPUT_REGISTERS_FUNCTION, DISCRETE_INPUTS_FUNCTION = 4, 2


def ask_twenty(client: ModbusBaseSyncClient) -> list[ModbusPDU]:
    """Twenty different requests to unit 1. Two go beyond the tables and get exception 02."""
    return [
        client.read_coils(0, count=11),
        client.read_coils(5, count=1),
        client.read_coils(0, count=SIZE),
        client.read_discrete_inputs(0, count=16),
        client.read_discrete_inputs(7, count=9),
        client.read_holding_registers(0, count=10),
        client.read_holding_registers(3, count=1),
        client.read_holding_registers(0, count=125),
        client.read_input_registers(0, count=4),
        client.read_input_registers(2, count=2),
        client.write_coil(3, True),
        client.write_register(20, 4660),
        client.write_registers(21, [1, 22136, 65535]),
        client.write_coils(8, [True, False, True, True]),
        client.mask_write_register(address=20, and_mask=0xF0F0, or_mask=0x0003),
        client.readwrite_registers(read_address=20, read_count=4, address=30, values=[7, 8]),
        client.read_holding_registers(20, count=12),
        client.read_coils(0, count=12),
        client.read_holding_registers(60000, count=2),
        client.write_register(60000, 1),
    ]


class Wire:
    """What a pymodbus client sends and receives, whole ADUs."""

    def __init__(self) -> None:
        self.requests: list[bytes] = []
        self.responses: list[bytes] = []

    def trace(self, sending: bool, data: bytes) -> bytes:
        """The client tells what it sends, and all that it holds each time it has received more."""
        if sending:
            self.requests.append(data)
            self.responses.append(b"")
        else:
            self.responses[-1] = data
        return data


@contextmanager
def tcp_client(port: int, host: str = "127.0.0.1") -> Iterator[tuple[ModbusTcpClient, Wire]]:
    wire = Wire()
    client: Any = ModbusTcpClient(
        host, port=port, timeout=PATIENCE_S, retries=0, trace_packet=wire.trace
    )
    assert client.connect()
    try:
        yield client, wire
    finally:
        client.close()


@contextmanager
def udp_client(
    port: int, framer: FramerType = FramerType.SOCKET
) -> Iterator[tuple[ModbusUdpClient, Wire]]:
    wire = Wire()
    client: Any = ModbusUdpClient(
        "127.0.0.1",
        port=port,
        framer=framer,
        timeout=PATIENCE_S,
        retries=0,
        trace_packet=wire.trace,
    )
    assert client.connect()
    try:
        yield client, wire
    finally:
        client.close()


@contextmanager
def rtu_client(port: str, baud: int) -> Iterator[tuple[ModbusSerialClient, Wire]]:
    wire = Wire()
    client: Any = ModbusSerialClient(
        port,
        framer=FramerType.RTU,
        baudrate=baud,
        timeout=PATIENCE_S,
        retries=0,
        trace_packet=wire.trace,
    )
    assert client.connect()
    try:
        yield client, wire
    finally:
        client.close()


class SecuredClient(ModbusTcpClient):
    """Modbus/TCP in TLS. The client of pymodbus that is for TLS leaves out the header."""

    def __init__(self, port: int, tls: ssl.SSLContext) -> None:
        super().__init__("127.0.0.1", port=port, timeout=PATIENCE_S, retries=0)
        self._tls = tls

    def connect(self) -> bool:
        plain: Any = super()
        client: Any = self
        is_connected = client.socket is not None
        if not is_connected and plain.connect():
            client.socket = self._tls.wrap_socket(client.socket, server_hostname="localhost")
        return client.socket is not None


@contextmanager
def pymodbus_server(
    tls: ssl.SSLContext | None = None, udp: FramerType | None = None
) -> Iterator[tuple[int, Callable[[], None]]]:
    """A server's port, and what changes its inputs."""
    loop = asyncio.new_event_loop()
    thread = Thread(target=loop.run_forever, daemon=True)
    thread.start()

    def call(coroutine: Any) -> Any:
        return asyncio.run_coroutine_threadsafe(coroutine, loop).result(PATIENCE_S)

    async def serve() -> ModbusTcpServer | ModbusUdpServer:
        address = ("127.0.0.1", 0)
        if udp is not None:
            datagrams = ModbusUdpServer(_device(), framer=udp, address=address)
            await datagrams.serve_forever(background=True)
            return datagrams
        server = (
            ModbusTcpServer(_device(), address=address)
            if tls is None
            else ModbusTlsServer(_device(), framer=FramerType.SOCKET, address=address, sslctx=tls)
        )
        await server.serve_forever(background=True)
        return server

    server = call(serve())
    numbers = iter(range(1, 1 << 16))

    def change() -> None:
        step = next(numbers)
        words = [(1000 * step + 7 * place) & 0xFFFF for place in range(SIZE)]
        bits = [(place + step) % 3 == 0 for place in range(SIZE)]
        context = server.context
        call(context.async_setValues(UNIT, INPUT_REGISTERS_FUNCTION, 0, words))
        call(context.async_setValues(UNIT, DISCRETE_INPUTS_FUNCTION, 0, bits))

    try:
        if udp is None:
            yield server.transport.sockets[0].getsockname()[1], change
        else:
            yield server.transport.get_extra_info("sockname")[1], change
    finally:
        call(server.shutdown())
        loop.call_soon_threadsafe(loop.stop)
        thread.join(PATIENCE_S)
        loop.close()


def _device() -> SimDevice:
    bits = [place % 5 == 0 for place in range(SIZE)]
    words = [10 * place for place in range(SIZE)]
    return SimDevice(
        UNIT,
        simdata=(
            [SimData(0, values=bits, datatype=DataType.BITS)],
            [SimData(0, values=bits, datatype=DataType.BITS)],
            [SimData(0, values=words, datatype=DataType.REGISTERS)],
            [SimData(0, values=words, datatype=DataType.REGISTERS)],
        ),
    )


@contextmanager
def slave_of_another(kind: str) -> Iterator[str]:
    """The LINK of a slave of another library (slaves_of_others.py)."""
    module, package = NEEDS[library_of(kind)]
    pytest.importorskip(module, reason=f"needs {package}: pip install {package}")
    mode = kind.rpartition("-")[2]
    with ExitStack() as stack:
        ends: tuple[str, ...] = ()
        if mode in ("rtu", "ascii"):
            line = stack.enter_context(api.line(f"{mode}@{SLAVE_BAUD}-8N1"))
            ends = (line.ports[1],)
        command = (sys.executable, "-m", "tests.end_to_end.slaves_of_others", kind, *ends)
        slave = stack.enter_context(Program(*command))
        place = slave.printed.find(r"listening on (\S+)")[1]
        scheme = "rtu+tcp" if kind.endswith("-rtu-tcp") else "tcp"
        yield line.link(0) if ends else f"{scheme}:127.0.0.1:{place}"


@contextmanager
def libmodbus_server(
    folder: Path, serial_port: str = ""
) -> Iterator[tuple[int, Callable[[], None]]]:
    """A server's port, 0 if it is on a serial one; it changes its inputs by itself."""
    compiler, finder = required("gcc", "gcc"), required("pkg-config", "pkg-config")
    found = subprocess.run(
        [finder, "--cflags", "--libs", "libmodbus"], capture_output=True, text=True, check=False
    )
    if found.returncode:
        pytest.skip("needs libmodbus: apt install libmodbus-dev")
    source = Path(__file__).with_name("libmodbus_server.c")
    program = folder / "libmodbus_server"
    flags = ["-Wall", "-Wextra", "-Werror", *shlex.split(found.stdout)]
    subprocess.run([compiler, source, "-o", program, *flags], check=True)
    with Program(str(program), *([serial_port] if serial_port else [])) as server:
        yield int(server.printed.find(r"listening on .*\b(\d+)")[1]), lambda: None


class RawTcpMaster:
    """Sends ADUs as they are and reads the answers by their length field."""

    def __init__(self, port: int) -> None:
        self._socket = socket.create_connection(("127.0.0.1", port), PATIENCE_S)

    def send(self, adu: bytes) -> None:
        self._socket.sendall(adu)

    def receive(self) -> bytes:
        header = self._exactly(6)
        return header + self._exactly(struct.unpack_from(">H", header, 4)[0])

    def is_silent(self) -> bool:
        """Whether nothing waits to be received."""
        return not select.select([self._socket], [], [], 0)[0]

    def close(self) -> None:
        self._socket.close()

    def _exactly(self, count: int) -> bytes:
        data = b""
        while len(data) < count:
            piece = self._socket.recv(count - len(data))
            assert piece, f"the connection ends after {data.hex(' ')}"
            data += piece
        return data
