"""The whole plant: the line, the connections, the programs that answer and that record.

    masters -> tap of "struck" -> tap of "steady" -> slave and replay
    line    -> slave (units 1 to 5), an ear of "struck", an ear of "steady"

"steady" runs from the beginning to the end; its memory and open files are watched. "struck" is
killed, ended and filled up, and started again.
"""

from __future__ import annotations

import contextlib
import os
import signal
import socket
import subprocess
import time
from pathlib import Path
from threading import Event, Thread
from typing import TYPE_CHECKING

from tests.soak.accounts import Life
from tests.soak.asked import Asked, Numbers, request_pdu, tcp_adu
from tests.soak.line import Line
from tests.soak.network import TcpMaster, connected, response_of
from tests.soak.programs import Running

if TYPE_CHECKING:
    import random

PROFILE = str(Path(__file__).with_name("unit.toml"))
LINE = "line"
CONNECTIONS = 20
UNITS_PLAYED = range(1, 6)
DISK_SIZE = "24m"


class Terminal:
    """The terminal that a program prints to; its reader can be stopped."""

    def __init__(self) -> None:
        self.near, self.far = os.openpty()
        self.is_read = Event()
        self.is_read.set()
        Thread(target=self._run, daemon=True).start()

    def _run(self) -> None:
        with contextlib.suppress(OSError):
            while self.is_read.wait() and os.read(self.near, 4096):
                pass


class Disk:
    """A small file system of its own; without root, None of it."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        folder.mkdir()
        command = ["mount", "-t", "tmpfs", "-o", f"size={DISK_SIZE}", "soak", str(folder)]
        self.is_small = (
            os.geteuid() == 0
            and not subprocess.run(command, check=False, capture_output=True).returncode
        )

    def fill(self) -> Path:
        """Leave no room; return the file that takes it."""
        filler = self.folder / "filler"
        with contextlib.suppress(OSError), filler.open("wb", buffering=0) as file:
            while True:
                file.write(bytes(4096))
        return filler

    def close(self) -> None:
        if self.is_small:
            subprocess.run(["umount", str(self.folder)], check=False, capture_output=True)


class Plant:
    """Everything that runs. `start`, then faults and time, then `end`."""

    def __init__(self, folder: Path, chance: random.Random) -> None:
        self.folder = folder
        self.clock = folder / "clock"
        self.clock.write_text("0", encoding="ascii")
        self.disk = Disk(folder / "disk")
        self.terminal = Terminal()
        self.numbers = Numbers()
        self.flooded: list[Asked] = []
        self.masters: list[TcpMaster] = []
        self.ended: list[Running] = []
        """Programs that are over: what they said is looked at in the end."""
        self.lives: dict[str, list[Life]] = {"steady": [], "struck": []}
        self.line = Line(LINE, folder, self.lives, chance)
        self.ports = {name: free_port() for name in ("slave", "replay")}
        self.taps = {(who, name): free_port() for who in self.lives for name in self.ports}

    def start(self) -> None:
        self.start_line_slave()
        self.slave = answering("slave", PROFILE, "--on", f"tcp:127.0.0.1:{self.ports['slave']}")
        recording = self._recording()
        on = f"tcp:127.0.0.1:{self.ports['replay']}"
        self.replay = answering("replay", str(recording), "--as-slave", "--on", on)
        self.steady = self._sniffer("steady", self.ports)
        self.start_struck()
        self.quiet_files = self.steady.open_files
        self.line.start()
        names = list(self.ports)
        for number in range(CONNECTIONS):
            name = names[number % len(names)]
            port = self.taps["struck", name]
            master = TcpMaster(self.link(name), port, self.numbers, number)
            self.masters.append(master)
            master.start()

    def link(self, name: str) -> str:
        return f"127.0.0.1:{self.ports[name]}"

    def start_line_slave(self) -> None:
        others = [("--unit", f"{unit}={PROFILE}") for unit in UNITS_PLAYED[1:]]
        units = [word for words in others for word in words]
        on = f"rtu:{self.line.slave.path}@115200-8N1"
        self.line_slave = answering("slave", PROFILE, *units, "--on", on)

    def start_struck(self) -> None:
        inner = {name: self.taps["steady", name] for name in self.ports}
        self.struck = self._sniffer("struck", inner)

    def _sniffer(self, who: str, targets: dict[str, int]) -> Running:
        number = len(self.lives[who])
        folder = self.disk.folder if who == "struck" else self.folder
        log = folder / f"{who}-{number}.mcap"
        is_steady = who == "steady"
        ear = self.line.ears[who]
        taps = [
            f"tap:127.0.0.1:{self.taps[who, name]}=127.0.0.1:{port}"
            for name, port in targets.items()
        ]
        rotating = ("--rotate", "1m") if is_steady else ()
        running = Running(
            *("sniff", f"rtu:{ear.path}@115200-8N1", *taps, "-w", str(log), *rotating),
            clock=self.clock if is_steady else None,
            stdout=self.terminal.far if is_steady else None,
        )
        running.await_line("listening on")
        self.lives[who].append(Life([log], time.time_ns()))
        return running

    def end_struck(self, signal_: int = 0) -> None:
        """End the sniffer by a signal; without one, its disk is full now, and it ends by itself."""
        life = self.lives["struck"][-1]
        life.ended_ns = time.time_ns()
        life.is_killed = signal_ in (0, signal.SIGKILL)
        if signal_:
            self.struck.end(signal_)
        else:
            self.struck.wait()
        self.ended.append(self.struck)

    def keep_struck_log(self) -> None:
        """Move the last log of "struck" off the small disk."""
        life = self.lives["struck"][-1]
        kept = self.folder / life.logs[0].name
        kept.write_bytes(life.logs[0].read_bytes())
        life.logs[0].unlink()
        life.logs = [kept]

    def end(self) -> None:
        for master in self.masters:
            master.stop()
        self.line.stop()
        time.sleep(1.0)
        self.last_files = self.steady.open_files
        life = self.lives["steady"][-1]
        life.ended_ns = time.time_ns()
        self.steady.end()
        life.logs = sorted(self.folder.glob("steady-0-*.mcap"))
        self.end_struck(signal.SIGINT)
        self.keep_struck_log()
        for one in (self.steady, self.slave, self.replay, self.line_slave):
            one.end()
            self.ended.append(one)
        self.disk.close()

    def asked(self) -> list[Asked]:
        """Everything that the plant sent, in the order of time."""
        sent = [*self.line.asked, *self.flooded]
        for master in self.masters:
            sent += master.asked
        return sorted(sent, key=lambda one: one.sent_ns)

    def _recording(self) -> Path:
        """A short recording of the slave, for replay."""
        log, port = self.folder / "recording.mcap", free_port()
        tap = f"tap:127.0.0.1:{port}=127.0.0.1:{self.ports['slave']}"
        sniffer = Running("sniff", tap, "-w", str(log), "--device", f"all={PROFILE}")
        sniffer.await_line("listening on")
        with connected(port) as connection:
            for number in range(40):
                connection.sendall(tcp_adu(number, request_pdu(number)))
                response_of(connection)
        sniffer.end()
        self.ended.append(sniffer)
        return log


def answering(*command: str) -> Running:
    running = Running(*command)
    running.await_line("Ctrl-C ends")
    return running


def free_port() -> int:
    with socket.socket() as one:
        one.bind(("127.0.0.1", 0))
        return int(one.getsockname()[1])
