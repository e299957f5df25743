"""Watches a virtual plant at work: python -m tests.benchmarks.watch_plant [OPTIONS].

    --rate 1000      transactions a second
    --seconds 60     of traffic
    --stopped 0      leave the terminal unread for so many seconds in the middle

A slave of `mbtool slave` is polled over ten connections through the tap of `mbtool watch -w`, on a
terminal of 80x24: one of tmux, or with --stopped a pseudo terminal that is not read for a while. At
the end the number of transactions that the screen shows is compared with those that the master
made and those in the log. The processor share and the memory are those of the watching process and
of what it started.
"""

from __future__ import annotations

import argparse
import os
import pty
import re
import shlex
import signal
import socket
import struct
import subprocess
import sys
import tempfile
import termios
import time
from contextlib import contextmanager, suppress
from fcntl import ioctl
from pathlib import Path
from threading import Event, Thread
from typing import TYPE_CHECKING, NamedTuple, Protocol

from mbtool.logs import LogReader
from mbtool.modbus import mbap_adu

if TYPE_CHECKING:
    from collections.abc import Iterator

CONNECTIONS, REGISTERS = 10, 10
PATIENCE_S = 60.0
_SHOWN = re.compile(r"([\d,]+) transactions?, [\d,]+ event")
_TICK_HZ = os.sysconf("SC_CLK_TCK")


class PlantWatch(NamedTuple):
    """What was seen. Times in s, memory in bytes."""

    asked: int
    answered: int
    shown: int
    logged: int
    seconds: float
    processor_s: float
    memory: int

    @property
    def agrees(self) -> bool:
        return self.asked == self.answered == self.shown == self.logged


class _Terminal(Protocol):
    pid: int

    def text(self) -> str: ...

    def press(self, key: str) -> None: ...


class _TmuxTerminal:
    """A terminal of tmux; what it shows can be read at any time."""

    def __init__(self, command: list[str], _stopped: Event) -> None:
        self._tmux = ["tmux", "-L", f"mbtool-{os.getpid()}", "-f", "/dev/null"]
        size = ["-x", "80", "-y", "24"]
        shell = f"exec {shlex.join(command)}"
        subprocess.run([*self._tmux, "new-session", "-d", *size, shell], check=True)
        subprocess.run([*self._tmux, "set", "-g", "status", "off"], check=True)
        subprocess.run([*self._tmux, "resize-window", *size], check=True)
        listed = [*self._tmux, "list-panes", "-F", "#{pane_pid}"]
        self.pid = int(subprocess.run(listed, check=True, capture_output=True).stdout)

    def text(self) -> str:
        shown = [*self._tmux, "capture-pane", "-p"]
        return subprocess.run(shown, check=False, capture_output=True, text=True).stdout

    def press(self, key: str) -> None:
        subprocess.run([*self._tmux, "send-keys", key], check=True)


class _StoppableTerminal:
    """A pseudo terminal that is not read while `stopped` is set."""

    def __init__(self, command: list[str], stopped: Event) -> None:
        self._ours, theirs = pty.openpty()
        ioctl(theirs, termios.TIOCSWINSZ, struct.pack("HHHH", 24, 80, 0, 0))
        process = subprocess.Popen(
            command, stdin=theirs, stdout=theirs, stderr=theirs, start_new_session=True
        )
        os.close(theirs)
        self.pid = process.pid
        self._stopped = stopped
        self._seen = b""
        Thread(target=self._read, daemon=True).start()
        Thread(target=process.wait, daemon=True).start()

    def _read(self) -> None:
        with suppress(OSError):
            while True:
                if self._stopped.is_set():
                    time.sleep(0.1)
                    continue
                data = os.read(self._ours, 65536)
                if not data:
                    return
                self._seen = (self._seen + data)[-200_000:]

    def text(self) -> str:
        """The last count that was drawn stands at the end of what was written."""
        plain = re.sub(rb"\x1b\[[0-9;?]*[A-Za-z]", b"", self._seen).decode(errors="replace")
        found = _SHOWN.findall(plain)
        return f"{found[-1]} transactions, 0 events" if found else ""

    def press(self, key: str) -> None:
        os.write(self._ours, key.encode())


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port: int = probe.getsockname()[1]
        return port


@contextmanager
def plant(port: int) -> Iterator[None]:
    """A slave at a port, by the program itself."""
    command = [sys.executable, "-m", "mbtool", "slave", "wago-750", "--on", f"tcp:127.0.0.1:{port}"]
    with subprocess.Popen(command, stderr=subprocess.DEVNULL) as process:
        try:
            _connected(port).close()
            yield
        finally:
            process.send_signal(signal.SIGINT)


def poll(port: int, rate: int, seconds: float) -> tuple[int, int]:
    """Ask at a rate; return how many were asked and answered."""
    talks = [_connected(port) for _ in range(CONNECTIONS)]
    asked = answered = 0
    began = time.monotonic()
    while (due := began + asked / rate) < began + seconds:
        time.sleep(max(due - time.monotonic(), 0))
        for at, talk in enumerate(talks):
            pdu = struct.pack(">BHH", 3, at * REGISTERS, REGISTERS)
            talk.sendall(mbap_adu(asked % 65536, 1, pdu))
            asked += 1
        for talk in talks:
            answered += len(talk.recv(4096)) > 0
    for talk in talks:
        talk.close()
    return asked, answered


def _connected(port: int) -> socket.socket:
    until = time.monotonic() + PATIENCE_S
    while True:
        try:
            return socket.create_connection(("127.0.0.1", port), timeout=PATIENCE_S)
        except ConnectionRefusedError:
            if time.monotonic() > until:
                raise
            time.sleep(0.1)


def watch_plant(rate: int, seconds: float, stopped_s: float, folder: Path) -> PlantWatch:
    """Run the plant, the screen and the master; `folder` gets the log."""
    slave_port, tap_port, log = free_port(), free_port(), folder / "plant.mcap"
    tap = f"tap:127.0.0.1:{tap_port}=127.0.0.1:{slave_port}"
    command = [sys.executable, "-m", "mbtool", "watch", tap, "-w", str(log)]
    command = ["env", f"XDG_CONFIG_HOME={folder}", "TERM=xterm-256color", *command]
    is_stopped = Event()
    with plant(slave_port):
        terminal: _Terminal = (_StoppableTerminal if stopped_s else _TmuxTerminal)(
            command, is_stopped
        )
        _connected(tap_port).close()
        before_s, began = processor_s(terminal.pid), time.monotonic()
        stopper = Thread(target=_stop, args=(is_stopped, (seconds - stopped_s) / 2, stopped_s))
        if stopped_s:
            stopper.start()
        asked, answered = poll(tap_port, rate, seconds)
        took_s = time.monotonic() - began
        shown = _settled(terminal)
        used_s, memory = processor_s(terminal.pid) - before_s, peak_memory(terminal.pid)
        terminal.press("q")
        _wait_for_end(terminal.pid)
    with LogReader.open(log) as reader:
        logged = sum(1 for _ in reader.transactions())
    return PlantWatch(asked, answered, shown, logged, took_s, used_s, memory)


def _stop(stopped: Event, after_s: float, for_s: float) -> None:
    time.sleep(after_s)
    stopped.set()
    time.sleep(for_s)
    stopped.clear()


def _settled(terminal: _Terminal) -> int:
    """The number that the screen shows, once it has not changed for two seconds."""
    last, since = -1, time.monotonic()
    until = since + PATIENCE_S
    while time.monotonic() < until and time.monotonic() - since < 2:
        time.sleep(0.3)
        found = _SHOWN.search(terminal.text())
        shown = int(found[1].replace(",", "")) if found else -1
        if shown != last:
            last, since = shown, time.monotonic()
    return last


def _wait_for_end(pid: int) -> None:
    until = time.monotonic() + PATIENCE_S
    while Path(f"/proc/{pid}").exists() and time.monotonic() < until:
        time.sleep(0.1)


def _family(pid: int) -> list[int]:
    """A process and those that it started."""
    found = [pid]
    for one in found:
        with suppress(OSError):
            for children in Path(f"/proc/{one}/task").glob("*/children"):
                found += map(int, children.read_text().split())
    return found


def processor_s(pid: int) -> float:
    total = 0
    for one in _family(pid):
        with suppress(OSError):
            fields = Path(f"/proc/{one}/stat").read_text().rpartition(")")[2].split()
            total += int(fields[11]) + int(fields[12])
    return total / _TICK_HZ


def peak_memory(pid: int) -> int:
    total = 0
    for one in _family(pid):
        with suppress(OSError):
            found = re.search(r"VmHWM:\s+(\d+) kB", Path(f"/proc/{one}/status").read_text())
            total += int(found[1]) * 1024 if found else 0
    return total


def told(seen: PlantWatch) -> str:
    """One line about it."""
    return (
        f"{seen.asked:,} asked, {seen.answered:,} answered, {seen.shown:,} shown, "
        f"{seen.logged:,} in the log ({'equal' if seen.agrees else 'NOT equal'}); "
        f"{seen.asked / seen.seconds:,.0f}/s for {seen.seconds:.0f} s; "
        f"processor {seen.processor_s / seen.seconds:.0%} of one core, "
        f"memory {seen.memory / 1e6:.0f} MB\n"
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--rate", type=int, default=1000)
    parser.add_argument("--seconds", type=float, default=60)
    parser.add_argument("--stopped", type=float, default=0)
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        sys.stdout.write(told(watch_plant(given.rate, given.seconds, given.stopped, Path(folder))))


if __name__ == "__main__":
    main()
