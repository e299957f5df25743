"""Follows the advice of `stats --advice` in plants, and compares the cycle with what was promised.

`python -m tests.adversary.advice [--plants 10] [--seed TEXT] [--baud 9600] [--master NAME]`:
pymodbus or minimalmodbus polls the embedded slave over a virtual serial line, which carries
characters as slowly as RS-485 does; `sniff` records it, and `stats --advice` tells which requests
could be one. Then the master polls that list, and is recorded again, both lists in turn. Takes a
minute for each plant, at slow rates minutes.
"""

from __future__ import annotations

import argparse
import json
import os
import signal
import subprocess
import sys
import time
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from random import Random
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any, Self

import minimalmodbus  # type: ignore[import-untyped, unused-ignore]
from pymodbus import ModbusException
from pymodbus.client import ModbusSerialClient

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

POLLED_S = 8.0
"""A list is polled at least so long, as the cycles of a busy machine differ."""
CYCLES = 4
CYCLES_OF_ONE = 8
"""The least number of cycles; a single poll must be seen more often to be known as a list."""
BAUDS = (1200, 2400, 4800, 9600, 19200)
ROUNDS = 3
"""Both lists are recorded so many times in turn; the quickest of each counts, as others have waited
for other programs of the machine."""
PATIENCE_S = 60.0


@dataclass(frozen=True, slots=True)
class Ask:
    """A read of holding registers (3) or input registers (4)."""

    unit: int
    function: int
    address: int
    quantity: int


@dataclass(slots=True)
class Plant:
    baud: int
    asks: list[Ask]
    wait_s: float
    """How long the master waits between two cycles."""
    limit: int
    """The most registers that a slave gives at once."""
    blocks: list[tuple[int, range]]
    """The registers that there are: function and addresses."""
    units: int


def plant(rng: Random, bauds: Sequence[int] = BAUDS) -> Plant:
    units, limit = rng.randint(1, 2), rng.choice((125, 125, 40))
    blocks: list[tuple[int, range]] = []
    asks: list[Ask] = []
    for function in (3, 4) if rng.random() < 0.3 else (3,):
        address = rng.choice((0, 100, 1000))
        for _ in range(rng.randint(1, 2)):
            parts = [rng.choice((1, 2, 2, 4, 8, 10)) for _ in range(rng.randint(2, 3))]
            blocks.append((function, range(address, address + sum(parts))))
            for unit in range(1, units + 1):
                at = address
                for size in parts:
                    asks.append(Ask(unit, function, at, size))
                    at += size
            address += sum(parts) + rng.randint(1, 20)
    return Plant(rng.choice(bauds), asks, rng.choice((0.0, 0.0, 0.3)), limit, blocks, units)


def profile(one: Plant) -> str:
    tables = {3: "holding_registers", 4: "input_registers"}
    areas = "".join(
        f'[[areas]]\nname = "block {number}"\ntable = "{tables[function]}"\nfirst = {span.start}\n'
        f'last = {span.stop - 1}\naccess = "r"\n\n'
        for number, (function, span) in enumerate(one.blocks)
    )
    functions = "".join(
        f"{function:02} = {{ limit = {one.limit} }}\n"
        for function in sorted({function for function, _ in one.blocks})
    )
    return (
        'name = "device"\ntitle = "device"\nvendor = "maker"\ntransports = ["rtu"]\n'
        f'source = "the test"\nfinding_prefix = "DEVICE"\n\n{areas}[functions]\n{functions}'
    )


def started(*arguments: str) -> subprocess.Popen[bytes]:
    return subprocess.Popen(
        [sys.executable, "-m", "mbtool", *arguments],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )


def ended(process: subprocess.Popen[bytes]) -> None:
    process.send_signal(signal.SIGINT)
    try:
        process.wait(PATIENCE_S)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()


def wait_for(*paths: Path) -> None:
    until = time.monotonic() + PATIENCE_S
    while not all(os.path.lexists(path) for path in paths):
        if time.monotonic() > until:
            raise TimeoutError(f"{paths} did not come")
        time.sleep(0.05)


class Pymodbus:
    """A master; a context."""

    def __init__(self, port: str, baud: int) -> None:
        self._client = ModbusSerialClient(port, baudrate=baud, timeout=3, retries=0)
        if not self._client.connect():
            raise ConnectionError(port)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._client.close()  # type: ignore[no-untyped-call]

    def is_refused(self, ask: Ask) -> bool | None:
        """Ask; return True for an exception response, None if there is no answer."""
        client = self._client
        read = client.read_holding_registers if ask.function == 3 else client.read_input_registers
        try:
            return bool(read(ask.address, count=ask.quantity, device_id=ask.unit).isError())
        except ModbusException:
            # What comes late would be taken for the next answer.
            client.close()  # type: ignore[no-untyped-call]
            time.sleep(1)
            client.connect()
            return None


class Minimalmodbus:
    """A master; a context."""

    def __init__(self, port: str, baud: int) -> None:
        self._slave = minimalmodbus.Instrument(port, 1)
        self._slave.serial.baudrate, self._slave.serial.timeout = baud, 3

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._slave.serial.close()

    def is_refused(self, ask: Ask) -> bool | None:
        """Ask; return True for an exception response, None if there is no answer."""
        self._slave.address = ask.unit
        try:
            self._slave.read_registers(ask.address, ask.quantity, ask.function)
        except minimalmodbus.SlaveReportedException:
            return True
        except minimalmodbus.ModbusException:
            time.sleep(1)
            return None
        return False


MASTERS: dict[str, type[Pymodbus | Minimalmodbus]] = {
    "pymodbus": Pymodbus,
    "minimalmodbus": Minimalmodbus,
}


def poll(port: Path, one: Plant, asks: Sequence[Ask], master: str) -> int:
    """Poll some cycles; return how many requests were refused."""
    refused = cycles = 0
    with MASTERS[master](str(port), one.baud) as client:
        until = time.monotonic() + PATIENCE_S
        while client.is_refused(Ask(1, asks[0].function, asks[0].address, 1)) is None:
            if time.monotonic() > until:
                raise TimeoutError("no slave answers")
        least = CYCLES if len(asks) > 1 else CYCLES_OF_ONE
        until = time.monotonic() + POLLED_S
        while cycles < least or time.monotonic() < until:
            cycles += 1
            for ask in asks:
                refused += client.is_refused(ask) or False
            if one.wait_s:
                time.sleep(one.wait_s)
    return refused


class Site:
    """A virtual line with its slaves; a context."""

    def __init__(self, folder: Path, one: Plant, master: str) -> None:
        self._folder, self._plant, self._master = folder, one, master
        self._ends = [folder / end for end in ("slave", "master", "tap")]
        self._running = ExitStack()
        self._runs = 0

    def __enter__(self) -> Site:
        device = self._folder / "device.toml"
        device.write_text(profile(self._plant))
        self._start("line", *map(str, self._ends), "--settings", self._settings)
        wait_for(*self._ends)
        numbers = range(2, self._plant.units + 1)
        others = [option for unit in numbers for option in ("--unit", f"{unit}={device}")]
        link = f"rtu:{self._ends[0]}@{self._settings}"
        self._start("slave", str(device), "--on", link, "--unit", "1", *others)
        return self

    def __exit__(self, *_: object) -> None:
        self._running.close()

    @property
    def _settings(self) -> str:
        return f"{self._plant.baud}-8N1"

    def _start(self, *arguments: str) -> subprocess.Popen[bytes]:
        process = started(*arguments)
        self._running.callback(ended, process)
        return process

    def recorded(self, asks: Sequence[Ask]) -> tuple[Path, int]:
        """Record a run of the master; return the log, and how many requests were refused."""
        self._runs += 1
        log = self._folder / f"{self._runs}.mcap"
        tap = started("sniff", f"rtu:{self._ends[2]}@{self._settings}", "-w", str(log))
        try:
            wait_for(log)
            refused = poll(self._ends[1], self._plant, asks, self._master)
            time.sleep(0.5)
        finally:
            ended(tap)
        return log, refused


def advised(log: Path, device: Path, units: int) -> Any:
    devices = [
        option for unit in range(1, units + 1) for option in ("--device", f"{unit}={device}")
    ]
    arguments = [sys.executable, "-m", "mbtool", "stats", str(log), "--advice", "--json", *devices]
    found = json.loads(subprocess.run(arguments, capture_output=True, check=True).stdout)
    found = [one for one in found if "reads" in one]
    return max(found, key=lambda one: one["requests"]) if found else None


def measured(log: Path) -> tuple[float, float] | None:
    """The cycle that `stats` shows of a recording, and the part of it that requests take (ms).

    None if it shows no list, as a busy machine makes the periods of a single request uneven.
    """
    arguments = [sys.executable, "-m", "mbtool", "stats", str(log), "--json"]
    document = json.loads(subprocess.run(arguments, capture_output=True, check=False).stdout)
    lists = [
        one for link in document["links"] for master in link["masters"] for one in master["lists"]
    ]
    if not lists:
        return None
    longest = max(lists, key=lambda one: len(one["steps"]))
    steps = longest["steps"]
    busy = sum(each["took_ms"] for each in steps) + sum(each["pause_ms"] for each in steps[1:])
    return float(longest["cycle_ms"]), float(busy)


def followed(asks: Sequence[Ask], reads: Sequence[dict[str, Any]]) -> list[Ask]:
    """The list of a master that follows the advice."""
    left = [*asks]
    for read in reads:
        span = range(read["address"], read["address"] + read["quantity"])
        own = [
            one
            for one in left
            if (one.unit, one.function) == (read["unit"], read["function"])
            and span.start <= one.address
            and one.address + one.quantity <= span.stop
        ]
        at = left.index(own[0])
        left[at] = Ask(read["unit"], read["function"], read["address"], read["quantity"])
        left = [one for one in left if one not in own]
    return left


def results(
    seed: str, plants: range, bauds: Sequence[int] = BAUDS, master: str = "pymodbus"
) -> Iterator[tuple[float, int]]:
    """Follow the advice in plants; yield how far off each promise was, and the requests refused."""
    for number in plants:
        one = plant(Random(f"{seed}-{number}"), bauds)
        with TemporaryDirectory() as temporary, Site(Path(temporary), one, master) as site:
            device = Path(temporary) / "device.toml"
            promises, shown, before, refused = [], [], [], 0
            then: list[Ask] = []
            waits = False
            for _ in range(ROUNDS):
                log, _ = site.recorded(one.asks)
                advice = advised(log, device, one.units)
                if advice is None:
                    continue
                then = then or followed(one.asks, advice["reads"])
                waits = advice["waits"]
                promises.append(advice["busy_then_ms" if waits else "cycle_then_ms"])
                before.append(advice["busy_ms" if waits else "cycle_ms"])
                log, more = site.recorded(then)
                refused += more
                if (found := measured(log)) is not None:
                    shown.append(found[waits])
            if not shown:
                what = "no cycle is shown" if then else "no advice"
                print(f"plant {number}: {what} for {len(one.asks)} requests")
                continue
            off = min(promises) / min(shown) - 1
            print(
                f"plant {number}: {one.baud} baud, {len(one.asks)} requests of {one.units} units "
                f"can be {len(then)}: {'requests take' if waits else 'cycle'} "
                f"{min(before):.0f} ms, promised {min(promises):.1f}, shown "
                f"{min(shown):.1f} ms ({off:+.1%}); {refused} refused",
                flush=True,
            )
            yield off, refused


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--plants", type=int, default=10)
    parser.add_argument("--first", type=int, default=0, help="the number of the first plant")
    parser.add_argument("--seed", default="a")
    parser.add_argument("--baud", type=int, action="append", help="only plants of this rate")
    parser.add_argument("--master", choices=MASTERS, default="pymodbus")
    chosen = parser.parse_args()
    plants = range(chosen.first, chosen.first + chosen.plants)
    found = list(results(chosen.seed, plants, chosen.baud or BAUDS, chosen.master))
    near = sum(abs(off) <= 0.05 for off, _ in found)
    print(f"within 5 %: {near} of {len(found)}; refused: {sum(refused for _, refused in found):g}")


if __name__ == "__main__":
    main()
