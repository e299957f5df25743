"""What is done to the plant while it runs: one fault after the other, each kind in turn."""

from __future__ import annotations

import signal
import time
from typing import TYPE_CHECKING

from tests.soak.network import flood, flood_of_connections

if TYPE_CHECKING:
    import random
    from collections.abc import Callable
    from pathlib import Path

    from tests.soak.plant import Plant

STEP_NS = 3600 * 1_000_000_000
FLOOD = 2000
FLOOD_CONNECTIONS = 150


class Faults:
    """Knows all faults; `next` does one and returns what it was."""

    def __init__(self, plant: Plant, chance: random.Random) -> None:
        self._plant = plant
        self._chance = chance
        self._deck: list[Callable[[], str]] = []
        self.steps = 0
        """How often the clock was set."""

    def next(self) -> str:
        if not self._deck:
            self._deck = [
                *(self.unplug, self.noise, self.flood, self.flood_of_connections, self.kill),
                *(self.end, self.fill_disk, self.set_clock, self.stop_terminal, self.stop_process),
                self.kill_slave,
            ]
            self._chance.shuffle(self._deck)
        return self._deck.pop()()

    def unplug(self) -> str:
        away_s = self._chance.uniform(0.5, 4.0)
        who = self._chance.choice(list(self._plant.line.ears))
        ear = self._plant.line.ears[who]
        ear.unplug()
        time.sleep(away_s)
        ear.plug()
        return f"unplugged the port of {who} for {away_s:.1f} s"

    def noise(self) -> str:
        self._plant.line.noise = 10
        return "noise on the line"

    def flood(self) -> str:
        plant = self._plant
        name = self._chance.choice(list(plant.ports))
        port = plant.taps["struck", name]
        plant.flooded += flood(plant.link(name), port, plant.numbers, FLOOD)
        return f"{FLOOD} requests at once to {name}"

    def flood_of_connections(self) -> str:
        flood_of_connections(self._plant.taps["struck", "slave"], FLOOD_CONNECTIONS)
        return f"{FLOOD_CONNECTIONS} connections that say nothing"

    def kill(self) -> str:
        self._plant.end_struck(signal.SIGKILL)
        return self._again("kill -9")

    def end(self) -> str:
        number = self._chance.choice((signal.SIGINT, signal.SIGTERM, signal.SIGHUP))
        self._plant.end_struck(number)
        return self._again(signal.Signals(number).name)

    def fill_disk(self) -> str:
        if not self._plant.disk.is_small:
            return "no full disk: that needs root"
        filler = self._plant.disk.fill()
        self._plant.end_struck()
        self._plant.keep_struck_log()
        filler.unlink()
        self._plant.start_struck()
        return "the disk was full"

    def set_clock(self) -> str:
        file: Path = self._plant.clock
        is_set = file.read_text(encoding="ascii") != "0"
        file.write_text("0" if is_set else str(STEP_NS), encoding="ascii")
        self.steps += 1
        return f"the clock was set {'back' if is_set else 'forward'} by an hour"

    def stop_terminal(self) -> str:
        self._plant.terminal.is_read.clear()
        time.sleep(10)
        self._plant.terminal.is_read.set()
        return "nobody read the terminal for 10 s"

    def stop_process(self) -> str:
        self._plant.steady.process.send_signal(signal.SIGSTOP)
        time.sleep(2)
        self._plant.steady.process.send_signal(signal.SIGCONT)
        return "the steady sniffer was stopped for 2 s"

    def kill_slave(self) -> str:
        plant = self._plant
        plant.line_slave.end(signal.SIGKILL)
        plant.ended.append(plant.line_slave)
        time.sleep(2)
        plant.start_line_slave()
        return "the line's slave was killed and started again"

    def _again(self, what: str) -> str:
        self._plant.keep_struck_log()
        self._plant.start_struck()
        return f"{what} of a sniffer, and started again"
