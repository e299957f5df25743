"""Masters of other makes poll a slave through a tap; `mbtool stats` must find their lists."""

from __future__ import annotations

import json
import re
import shutil
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, suppress
from threading import Event
from typing import TYPE_CHECKING, Any

import pytest
from pymodbus.client import ModbusTcpClient
from pymodbus.exceptions import ModbusIOException

from mbtool.core import Endpoint, TcpLink
from mbtool.modbus import Response
from mbtool.slave.shells import TcpSlave
from tests.end_to_end.programs import Program, mbtool, required
from tests.slave.scripted import Scripted

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

CYCLES = 20
PAUSE_S = 0.05
TIMEOUT_S = 0.2
DEAD = 9
"""A unit that never answers."""

Poll = tuple[int, int, int]
"""Unit, function and address."""
A, B, C, D, E = (1, 3, 0), (1, 4, 10), (2, 3, 20), (2, 1, 30), (1, 3, 40)
LOST: Poll = (DEAD, 3, 0)
WRITE: Poll = (1, 6, 5)


def answer(unit: int, pdu: bytes) -> Response | None:
    """Zeros for what is read; the request itself for what is written; nothing of a dead unit."""
    if unit == DEAD:
        return None
    quantity = int.from_bytes(pdu[3:5])
    match pdu[0]:
        case 1 | 2:
            size = -(-quantity // 8)
            return Response(bytes([pdu[0], size]) + bytes(size))
        case 3 | 4:
            return Response(bytes([pdu[0], 2 * quantity]) + bytes(2 * quantity))
    return Response(pdu[:5])


def lists_of(figures: dict[str, Any]) -> list[list[Poll]]:
    (master,) = figures["masters"]
    polls = {
        poll["number"]: (poll["unit"], poll["function"], poll["address"])
        for poll in figures["polls"]
    }
    return [[polls[step["poll"]] for step in one["steps"]] for one in master["lists"]]


def ask(client: ModbusTcpClient, poll: Poll) -> None:
    unit, function, address = poll
    with suppress(ModbusIOException):
        match function:
            case 1:
                client.read_coils(address, count=4, device_id=unit)
            case 3:
                client.read_holding_registers(address, count=2, device_id=unit)
            case 4:
                client.read_input_registers(address, count=2, device_id=unit)
            case 6:
                client.write_register(address, 7, device_id=unit)


def pymodbus_run(port: int, cycles: Sequence[Sequence[Poll]], retries: int = 0) -> None:
    """Ask cycle after cycle, with a pause after each."""
    client = ModbusTcpClient("127.0.0.1", port=port, timeout=TIMEOUT_S, retries=retries)
    assert client.connect()  # type: ignore[no-untyped-call]
    for cycle in cycles:
        for poll in cycle:
            ask(client, poll)
        Event().wait(PAUSE_S)
    client.close()  # type: ignore[no-untyped-call]


def in_turn(*parts: Callable[[int], list[Poll]]) -> list[list[Poll]]:
    return [[poll for part in parts for poll in part(at)] for at in range(CYCLES)]


PLANS: dict[str, tuple[list[list[Poll]], int, list[list[Poll]]]] = {
    "a list": ([[A, B, C, D]] * CYCLES, 0, [[A, B, C, D]]),
    "a poll twice in a list": ([[A, B, A, C]] * CYCLES, 0, [[A, B, A, C]]),
    "a slow list in each fourth cycle": (
        in_turn(lambda _: [A, B], lambda at: [] if at % 4 else [C, D, E]),
        0,
        [[A, B], [C, D, E]],
    ),
    "writes in between": (
        in_turn(lambda _: [A, B, C], lambda at: [WRITE] if at in (3, 4, 9, 15) else []),
        0,
        [[A, B, C]],
    ),
    "a dead unit": ([[A, LOST, B]] * (CYCLES // 3), 0, [[A, LOST, B]]),
    "a dead unit with a retry": ([[A, LOST, B]] * (CYCLES // 4), 1, [[A, LOST, B]]),
}


MBPOLL_UNITS = {"mbpoll of one unit": [1], "mbpoll of three": [1, 2, 3], "mbpoll of two": [4, 2]}


@pytest.fixture(scope="module")
def figures() -> dict[str, dict[str, Any]]:
    """What one `mbtool stats` says of all masters at once, each with a slave of its own."""
    names = [*PLANS, *(MBPOLL_UNITS if shutil.which("mbpoll") else ())]
    scripts = {name: Scripted(answer) for name in names}
    with ExitStack() as stack:
        slaves = {
            name: stack.enter_context(TcpSlave(TcpLink(Endpoint("127.0.0.1", 0)), script))
            for name, script in scripts.items()
        }
        taps = [f"tap:127.0.0.1:0={slave.endpoint}" for slave in slaves.values()]
        program = stack.enter_context(mbtool("stats", *taps, "--json"))
        said = program.said.find(r"listening on .*")[0]
        ports = dict(
            zip(names, map(int, re.findall(r"tap:127\.0\.0\.1:(\d+)=", said)), strict=True)
        )
        with ThreadPoolExecutor(len(names)) as pool:
            list(pool.map(lambda name: run_master(name, ports[name], scripts[name]), names))
        assert program.interrupt() == 130, program.said.text
        links = {link["link"]: link for link in json.loads(program.printed.text)["links"]}
        return {name: links[str(slave.endpoint)] for name, slave in slaves.items()}


def run_master(name: str, port: int, script: Scripted) -> None:
    if name in PLANS:
        cycles, retries, _ = PLANS[name]
        pymodbus_run(port, cycles, retries)
        return
    units = MBPOLL_UNITS[name]
    options = ("-m", "tcp", "-p", str(port), "-r", "1", "-c", "2", "-l", "100")
    with Program("mbpoll", *options, "-a", ",".join(map(str, units)), "127.0.0.1") as master:
        script.await_asked(8 * len(units))
        master.interrupt()


@pytest.mark.parametrize("name", PLANS)
def test_the_lists_of_pymodbus_are_found(name: str, figures: dict[str, dict[str, Any]]) -> None:
    cycles, retries, wanted = PLANS[name]
    found = figures[name]
    assert lists_of(found) == wanted
    asked = sum(poll != LOST for cycle in cycles for poll in cycle)
    lost = sum(poll == LOST for cycle in cycles for poll in cycle)
    assert (found["ok"], found["no_answer"]) == (asked, lost * (1 + retries))
    assert found["retries"] >= lost * retries
    assert found["watched_s"] >= PAUSE_S * (len(cycles) - 1)
    if lost:
        # A busy machine notes a request late, and its repetition in time.
        assert found["masters"][0]["response_timeout_ms"] >= TIMEOUT_S * 500


@pytest.mark.peers
@pytest.mark.parametrize("name", MBPOLL_UNITS)
def test_the_list_of_mbpoll_is_found(name: str, figures: dict[str, dict[str, Any]]) -> None:
    required("mbpoll", package="mbpoll")
    assert lists_of(figures[name]) == [[(unit, 3, 0) for unit in MBPOLL_UNITS[name]]]
    (found,) = figures[name]["masters"][0]["lists"]
    assert found["cycle_ms"] >= 90
