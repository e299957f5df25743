"""Slaves of other Modbus libraries: `python -m tests.end_to_end.slaves_of_others KIND [PORT]`.

Each is a process of its own, as several of them print, warn or stop in ways that no test should
meet. It says where it listens, on a free TCP port or on the serial PORT that is given, and runs
until it is killed. AREAS says which addresses each lets read.
"""

from __future__ import annotations

import asyncio
import sys
import threading
import warnings
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Callable

UNIT = 1
BAUD = 19200
HOST = "127.0.0.1"
Areas = dict[str, list[tuple[int, int]]]
"""By table: the first and the last address of each area."""
_TABLES = ("coils", "discrete_inputs", "holding_registers", "input_registers")
_PYMODBUS: Areas = {
    "coils": [(0, 207)],  # pymodbus keeps bits in whole registers.
    "discrete_inputs": [(0, 207)],
    "holding_registers": [(0, 199)],
    "input_registers": [(0, 199)],
}
_MODBUS_TK: Areas = {
    "coils": [(0, 15)],
    "discrete_inputs": [(100, 139)],
    "holding_registers": [(0, 9), (300, 444)],
    "input_registers": [(20, 59)],
}
_UMODBUS: Areas = {
    "coils": [(0, 31)],
    "discrete_inputs": [],
    "holding_registers": [(0, 49), (400, 433)],
    "input_registers": [(0, 19)],
}
_PYMODBUSTCP: Areas = {table: [(0, 99)] for table in _TABLES}
AREAS: dict[str, Areas] = {
    "pymodbus-tcp": _PYMODBUS,
    "pymodbus-rtu-tcp": _PYMODBUS,
    "pymodbus-rtu": _PYMODBUS,
    "pymodbus-ascii": _PYMODBUS,
    "modbus-tk-tcp": _MODBUS_TK,
    "modbus-tk-rtu": _MODBUS_TK,
    "umodbus-tcp": _UMODBUS,
    "pymodbustcp-tcp": _PYMODBUSTCP,
}
NEEDS = {
    "pymodbus": ("pymodbus", "pymodbus"),
    "modbus-tk": ("modbus_tk", "modbus-tk"),
    "umodbus": ("umodbus", "umodbus"),
    "pymodbustcp": ("pyModbusTCP", "pyModbusTCP"),
}
"""By library: the module to import, and the name with which pip installs it."""


def _say(where: object) -> None:
    print(f"listening on {where}", flush=True)  # noqa: T201 - the test waits for it


def _of_pymodbus(kind: str, port: str) -> None:
    from pymodbus import FramerType
    from pymodbus.server import ModbusSerialServer, ModbusTcpServer
    from pymodbus.simulator import DataType, SimData, SimDevice

    bits, words = [place % 5 == 0 for place in range(200)], [10 * place for place in range(200)]
    one_bit = [SimData(0, values=bits, datatype=DataType.BITS)]
    one_word = [SimData(0, values=words, datatype=DataType.REGISTERS)]
    device = SimDevice(UNIT, simdata=(one_bit, list(one_bit), one_word, list(one_word)))

    async def serve() -> None:
        server: Any
        if kind.endswith("tcp"):
            framer = FramerType.RTU if kind == "pymodbus-rtu-tcp" else FramerType.SOCKET
            server = ModbusTcpServer(device, framer=framer, address=(HOST, 0))
        else:
            framer = FramerType.ASCII if kind == "pymodbus-ascii" else FramerType.RTU
            server = ModbusSerialServer(device, framer=framer, port=port, baudrate=BAUD)
        await server.serve_forever(background=True)
        is_tcp = kind.endswith("tcp")
        _say(server.transport.sockets[0].getsockname()[1] if is_tcp else port)
        await asyncio.Event().wait()

    asyncio.run(serve())


def _of_modbus_tk(kind: str, port: str) -> None:
    import modbus_tk.defines as words
    from modbus_tk import modbus_rtu, modbus_tcp

    server: Any
    if kind == "modbus-tk-tcp":

        class Server(modbus_tcp.TcpServer):  # type: ignore[misc, unused-ignore]
            def _do_init(self) -> None:
                super()._do_init()
                _say(self._sock.getsockname()[1])

        server = Server(port=0, address=HOST)
    else:
        import serial

        server = modbus_rtu.RtuServer(serial.Serial(port, BAUD))
        _say(port)
    slave = server.add_slave(UNIT)
    kinds = (words.COILS, words.DISCRETE_INPUTS, words.HOLDING_REGISTERS, words.ANALOG_INPUTS)
    for table, number in zip(_TABLES, kinds, strict=True):
        for first, last in _MODBUS_TK[table]:
            slave.add_block(f"{table} {first}", number, first, last + 1 - first)
    server.start()
    threading.Event().wait()


def _of_umodbus(_kind: str, _port: str) -> None:
    from socketserver import ThreadingTCPServer

    from umodbus.server.tcp import RequestHandler, get_server

    server: Any = get_server(ThreadingTCPServer, (HOST, 0), RequestHandler)
    _say(server.server_address[1])
    for table, code in zip(_TABLES, (1, 2, 3, 4), strict=True):
        addresses = [at for first, last in _UMODBUS[table] for at in range(first, last + 1)]
        if addresses:
            server.route(slave_ids=[UNIT], function_codes=[code], addresses=addresses)(
                lambda slave_id, function_code, address: address % 2
            )
    server.serve_forever()


def _of_pymodbustcp(_kind: str, _port: str) -> None:
    from pyModbusTCP.server import DataBank, ModbusServer

    sizes = {f"{one}_size": 100 for one in ("coils", "d_inputs", "h_regs", "i_regs")}
    server = ModbusServer(HOST, 0, no_block=True, data_bank=DataBank(**sizes))
    server.start()
    _say(server._service.server_address[1])
    threading.Event().wait()


def main(kind: str, port: str = "") -> None:
    warnings.simplefilter("ignore")
    makers: dict[str, Callable[[str, str], None]] = {
        "pymodbus": _of_pymodbus,
        "modbus-tk": _of_modbus_tk,
        "umodbus": _of_umodbus,
        "pymodbustcp": _of_pymodbustcp,
    }
    makers[library_of(kind)](kind, port)


def library_of(kind: str) -> str:
    """The library of a kind: `modbus-tk` of `modbus-tk-rtu`."""
    return next(name for name in NEEDS if kind.startswith(f"{name}-"))


if __name__ == "__main__":
    main(*sys.argv[1:])
