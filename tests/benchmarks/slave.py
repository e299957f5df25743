"""What the embedded slave takes: python -m tests.benchmarks.slave [OPTIONS].

    --seconds 2     of each slave, in each of the rounds
    --rounds 5
    --profile       where mbtool's slave spends its time, instead

Reads 10 holding registers (FC3) from each slave over Modbus/TCP on loopback, as fast as it answers,
over 1 connection and over 8, each with one request on its way. The client is the same for all, and
a process of its own: a C program (slave_client.c), so that it is not what is measured. Every
answer is checked.

    mbtool ft1a   `mbtool slave idec-ft1a-touch`, as users run it
    mbtool fa3    `mbtool slave fa3-at1m8x`, whose rules allow two connections: measured with 1 only
    asyncio       a bare BufferedProtocol that sends the same bytes back for any request: what the
                  event loop leaves a slave
    pymodbus      its asynchronous server
    libmodbus     its C library, with select in one thread (slave_libmodbus.c)

The slaves take turns, round by round, so that what slows the machine slows all; of each the median
round counts. "cpu us" is the slave's processor time for a request, which other work on the machine
disturbs less than the rate. Absolute figures are the machine's; the ratios are what counts.
Without a C compiler nothing can be measured; without libmodbus's headers it is left out.
"""

from __future__ import annotations

import argparse
import asyncio
import cProfile
import json
import os
import pstats
import re
import shutil
import signal
import socket
import statistics
import subprocess
import sys
import tempfile
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from mbtool.core import Endpoint, TcpLink
from mbtool.devices import load_profile
from mbtool.slave.device import RegisterImage, units_on
from mbtool.slave.families import make_device
from mbtool.slave.shells import TcpSlave

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence
    from contextlib import AbstractContextManager

HERE = Path(__file__).parent
CONNECTIONS = (1, 8)
FT1A, FA3, BARE = "mbtool ft1a", "mbtool fa3", "asyncio"
PYMODBUS, LIBMODBUS = "pymodbus", "libmodbus"
PLACES = {FA3: 2}
"""How many masters a slave takes at once, where that is fewer than are measured."""
PATIENCE_S = 120.0
_AS_SLAVE, _PROFILED = "--as-slave", "--as-profiled"


class MissingError(Exception):
    """Something that is measured with is not on this machine."""


@dataclass(frozen=True, slots=True)
class Round:
    """One slave, asked for a while."""

    slave: str
    connections: int
    rate: float
    """Requests a second."""
    p99_us: float
    cpu_us: float | None
    """The slave's processor time for one request, where the system tells."""


@dataclass(frozen=True, slots=True)
class Server:
    """A slave in a process of its own."""

    name: str
    port: int
    pid: int


def main() -> None:
    if sys.argv[1:2] == [_AS_SLAVE]:
        _SLAVES[sys.argv[2]]()
        return
    if sys.argv[1:2] == [_PROFILED]:
        _serve_profiled()
        return
    assert __doc__ is not None
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--seconds", type=float, default=2.0)
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--profile", action="store_true")
    options = parser.parse_args()
    try:
        if options.profile:
            profile(options.seconds)
        else:
            sys.stdout.write(report(measure(options.rounds, options.seconds)))
    except MissingError as error:
        sys.exit(f"tests.benchmarks.slave: {error}")


def measure(rounds: int, seconds: float) -> list[Round]:
    measured = []
    with ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        client = compile_c("slave_client", folder)
        servers = [stack.enter_context(each) for each in _servers(folder)]
        for _ in range(rounds):
            for connections in CONNECTIONS:
                measured += [
                    ask(client, server, connections, seconds)
                    for server in servers
                    if connections <= PLACES.get(server.name, connections)
                ]
    return measured


def ask(client: Path, server: Server, connections: int, seconds: float) -> Round:
    before_s = _cpu_s(server.pid)
    command = [str(client), str(server.port), str(connections), str(seconds)]
    done = subprocess.run(command, check=True, capture_output=True, timeout=seconds + PATIENCE_S)
    after_s = _cpu_s(server.pid)
    told = json.loads(done.stdout)
    cpu_us = None
    if before_s is not None and after_s is not None:
        cpu_us = (after_s - before_s) * 1e6 / told["count"]
    rate = told["count"] / told["seconds"]
    return Round(server.name, connections, rate, told["p99_ns"] / 1e3, cpu_us)


def report(measured: Sequence[Round]) -> str:
    lines = []
    for connections in CONNECTIONS:
        of_this = [one for one in measured if one.connections == connections]
        lines.append(
            f"{_counted(connections):16}{'requests/s':>12}{'p99 us':>9}{'cpu us':>9}"
            f"{'x pymodbus':>13}{'by cpu':>8}{'x libmodbus':>13}{'by cpu':>8}"
        )
        for slave in dict.fromkeys(one.slave for one in of_this):
            mine = [one for one in of_this if one.slave == slave]
            cpu = [one.cpu_us for one in mine if one.cpu_us is not None]
            lines.append(
                f"  {slave:14}{statistics.median(one.rate for one in mine):12,.0f}"
                f"{statistics.median(one.p99_us for one in mine):9.0f}"
                + (f"{statistics.median(cpu):9.1f}" if cpu else f"{'-':>9}")
                + "".join(_ratios(of_this, slave, other) for other in (PYMODBUS, LIBMODBUS))
            )
    return "\n".join(lines) + "\n"


def compile_c(name: str, folder: Path, *flags: str) -> Path:
    """Build one of the C programs beside this file. Raises MissingError."""
    compiler = shutil.which("cc") or shutil.which("gcc")
    if compiler is None:
        raise MissingError("there is no C compiler (cc or gcc)")
    program = folder / name
    command = [compiler, "-O2", "-o", str(program), str(HERE / f"{name}.c"), *flags]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        raise MissingError(f"{name}.c cannot be compiled: {done.stderr.strip().splitlines()[0]}")
    return program


def libmodbus_flags() -> list[str]:
    """What the compiler needs for libmodbus."""
    found = subprocess.run(
        ["pkg-config", "--cflags", "--libs", "libmodbus"],
        capture_output=True,
        text=True,
        check=False,
    )
    return found.stdout.split() or ["-I/usr/include/modbus", "-lmodbus"]


def profile(seconds: float) -> None:
    """Say where the slave spends its time."""
    with tempfile.TemporaryDirectory() as folder:
        client = compile_c("slave_client", Path(folder))
        with _python(FT1A, _PROFILED) as server:
            ask(client, server, 8, seconds)


def _counted(connections: int) -> str:
    return f"{connections} connection{'s' if connections > 1 else ''}"


def _ratios(measured: Sequence[Round], slave: str, other: str) -> str:
    """How many times the rate of another, in a second and in a second of processor time."""
    mine, theirs = ([one for one in measured if one.slave == each] for each in (slave, other))
    if not theirs:
        return f"{'-':>13}{'-':>8}"
    rate = statistics.median(one.rate for one in mine) / statistics.median(
        one.rate for one in theirs
    )
    my_cpu, their_cpu = (
        [one.cpu_us for one in each if one.cpu_us is not None] for each in (mine, theirs)
    )
    if not my_cpu or not their_cpu:
        return f"{rate:13.2f}{'-':>8}"
    return f"{rate:13.2f}{statistics.median(their_cpu) / statistics.median(my_cpu):8.2f}"


def _cpu_s(pid: int) -> float | None:
    """The processor time of a process, where /proc tells it."""
    try:
        fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    except OSError:
        return None
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


# The slaves.


def _servers(folder: Path) -> Iterator[AbstractContextManager[Server]]:
    yield _mbtool(FT1A, "idec-ft1a-touch")
    yield _mbtool(FA3, "fa3-at1m8x")
    yield _python(BARE, _AS_SLAVE, BARE)
    yield _python(PYMODBUS, _AS_SLAVE, PYMODBUS)
    try:
        libmodbus = compile_c("slave_libmodbus", folder, *libmodbus_flags())
    except MissingError as error:
        sys.stderr.write(f"left out: {error}\n")
        return
    yield _running(LIBMODBUS, [str(libmodbus)])


def _python(name: str, *arguments: str) -> AbstractContextManager[Server]:
    return _running(name, [sys.executable, "-m", "tests.benchmarks.slave", *arguments])


def _mbtool(name: str, profile_name: str) -> AbstractContextManager[Server]:
    command = [sys.executable, "-m", "mbtool", "slave", profile_name, "--on", "tcp:127.0.0.1:0"]
    return _running(name, command)


@contextmanager
def _running(name: str, command: Sequence[str]) -> Iterator[Server]:
    """A slave that says its port in its first line, at the line's end or before a semicolon."""
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
    ) as child:
        try:
            assert child.stdout is not None
            said = child.stdout.readline()
            port = re.search(r"(\d+)(?:;|$)", said)
            assert port is not None, said
            yield Server(name, int(port[1]), child.pid)
        finally:
            child.terminate()
            if _PROFILED in command:
                assert child.stdout is not None
                sys.stdout.write(child.stdout.read())


class _Bare(asyncio.BufferedProtocol):
    """Sends the same answer for whatever comes, with the transaction id that it has."""

    _transport: asyncio.Transport

    def __init__(self) -> None:
        self._buffer = memoryview(bytearray(2048))
        self._answer = bytes.fromhex("0000 0017 01 03 14") + bytes(20)

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        assert isinstance(transport, asyncio.Transport)
        self._transport = transport

    def get_buffer(self, sizehint: int) -> memoryview:
        return self._buffer

    def buffer_updated(self, nbytes: int) -> None:
        self._transport.write(bytes(self._buffer[:2]) + self._answer)


async def _serve_bare() -> None:
    server = await asyncio.get_running_loop().create_server(_Bare, "127.0.0.1", 0)
    _say(str(server.sockets[0].getsockname()[1]))
    await server.serve_forever()


async def _serve_pymodbus() -> None:
    from pymodbus.server import ModbusTcpServer
    from pymodbus.simulator import DataType, SimData, SimDevice

    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    registers = SimData(0, count=4096, values=0, datatype=DataType.REGISTERS)
    server = ModbusTcpServer(SimDevice(1, simdata=[registers]), address=("127.0.0.1", port))
    _say(str(port))
    await server.serve_forever()


def _serve_profiled() -> None:
    """mbtool's slave under a profiler, until the end of its input tells it to stop."""
    link = TcpLink(Endpoint("127.0.0.1", 0))
    device_profile = load_profile("idec-ft1a-touch")
    device = make_device(device_profile, RegisterImage.of(device_profile))
    slave = TcpSlave(link, units_on(link, device_profile, 1, device))
    slave._open()
    profiler = cProfile.Profile()
    _say(str(slave.endpoint.port))
    signal.signal(signal.SIGTERM, lambda *_: slave._interrupt())
    profiler.runcall(slave._run)
    pstats.Stats(profiler, stream=sys.stdout).sort_stats("tottime").print_stats(25)


def _say(line: str) -> None:
    sys.stdout.write(f"{line}\n")
    sys.stdout.flush()


_SLAVES: dict[str, Callable[[], None]] = {
    BARE: lambda: asyncio.run(_serve_bare()),
    PYMODBUS: lambda: asyncio.run(_serve_pymodbus()),
}


if __name__ == "__main__":
    main()
