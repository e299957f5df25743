"""The checks that run in the guest: python -m tests.real_drivers.in_guest OUT [CHECK...].

`host` there steers the other end of the lines; its README says what this cannot show.
"""

from __future__ import annotations

import fcntl
import json
import re
import signal
import struct
import subprocess
import sys
import termios
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mbtool.core import Chunk, SerialFormat
from mbtool.core.serial_format import ModemLine, ModemLines
from mbtool.logs import LogReader
from mbtool.ports.posix_serial import PosixPort

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

UART, FTDI = "/dev/ttyS1", "/dev/ttyUSB0"
FORMAT = SerialFormat(19200, 8, "E", 1)
OPENINGS = 20
PULLS = 3
WAIT_S = 60.0


def host(*words: str) -> str:
    """Ask the other end of the lines."""
    done = subprocess.run(["host", *words], capture_output=True, text=True, check=True)
    return done.stdout.strip()


def mbtool(*words: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "mbtool", *words], capture_output=True, text=True, check=False
    )


def rates() -> Iterator[str]:
    """(a) A rate that the port cannot do is refused; others are not."""
    for command in (("sniff",), ("slave", "idec-ft1a-touch", "--on")):
        done = mbtool(*command, f"rtu:{UART}@230400-8N1")
        if done.returncode != 3 or "does not do 230400 baud, and has set" not in done.stderr:
            yield f"{command[0]} of 230400 baud: {done.returncode} {done.stderr}"
    for port, baud in ((UART, 115200), (UART, 9600), (FTDI, 230400), (FTDI, 19200)):
        PosixPort(port, SerialFormat(baud, 8, "N", 1)).close()


def pulls() -> Iterator[str]:
    """(b) An adapter that is pulled and plugged: alone, and beside a port that goes on."""
    for name, links in (("alone", (FTDI,)), ("beside", (FTDI, UART))):
        log = Path(sys.argv[1], f"{name}.mcap")
        yield from _pulled(log, links)


def _pulled(log: Path, links: tuple[str, ...]) -> Iterator[str]:
    specs = [f"rtu:{link}@{FORMAT}" for link in links]
    with subprocess.Popen(
        [sys.executable, "-m", "mbtool", "sniff", *specs, "-w", str(log), "--overwrite"],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
    ) as sniffer:
        assert sniffer.stderr is not None
        _await(sniffer.stderr, "listening on")
        before = received()
        for line in ("usb", "s1"):
            # Slow enough for a machine that is interpreted; the other end drops what it does not
            # take in time, at most some 17 pieces.
            host("pause", line, "0.5")
            host("burst", line, "64")
            host("traffic", line, "on")
        for _ in range(PULLS):
            time.sleep(5)
            host("pull")
            _await(sniffer.stderr, "lost")
            time.sleep(2)
            host("plug")
            _await(sniffer.stderr, "is back")
        time.sleep(5)
        for line in ("usb", "s1"):
            host("traffic", line, "off")
        time.sleep(2)
        driver_bytes = received() - before
        sniffer.send_signal(signal.SIGINT)
        sniffer.wait()
    yield from _judged(log, links)
    say(f"  the other end: usb {host('sent', 'usb')}; s1 {host('sent', 's1')}")
    if UART in links:
        with LogReader.open(log) as reader:
            logged = sum(
                len(one.data)
                for one in reader.evidence()
                if isinstance(one, Chunk) and one.link == Path(UART).name
            )
        say(f"  {UART}: its driver has heard {driver_bytes} bytes, {logged} are in the log")
        if logged != driver_bytes:
            yield f"{UART}: {driver_bytes} bytes heard, {logged} in the log"


def received() -> int:
    """How many bytes the driver of the 8250 has heard since the boot."""
    text = Path("/proc/tty/driver/serial").read_text()
    found = re.search(r"^1:.* rx:(\d+)", text, re.MULTILINE)
    return int(found[1]) if found else 0


def _judged(log: Path, links: tuple[str, ...]) -> Iterator[str]:
    done = mbtool("decode", str(log), "--format", "jsonl", "--events", "all")
    records: list[dict[str, Any]] = [json.loads(line) for line in done.stdout.splitlines()]
    for link in links:
        name = Path(link).name
        mine = [one for one in records if one["link"] == name]
        gaps = [one["message"] for one in mine if one.get("kind") == "gap"]
        asked = [one for one in mine if one.get("outcome") == "ok"]
        other = [one for one in mine if one not in asked and one.get("kind") != "gap"]
        say(f"  {log.name} {name}: {len(asked)} whole, {len(gaps)} gaps, {len(other)} others")
        if len(gaps) != (2 * PULLS if link == FTDI else 0):
            yield f"{log.name} {name}: {gaps}"
        # A pull may cut a transaction in two, and so does the moment when listening begins again.
        if len(other) > (2 * PULLS if link == FTDI else 0) or len(asked) < 20:
            yield f"{log.name} {name}: {len(asked)} transactions, and {other[:5]}"
    names = {one["link"] for one in records}
    if names != {Path(link).name for link in links}:
        yield f"{log.name}: the links are called {names}"


def echoes() -> Iterator[str]:
    """(c) What openings write to a busy line, from a port that was not raw before, or was."""
    for port, line in ((UART, "s1"), (FTDI, "usb")):
        host("traffic", line, "on")
        written = []
        for _ in range(OPENINGS):
            subprocess.run(["stty", "-F", port, "sane", "echo"], check=True)
            time.sleep(0.2)
            host("heard", line)
            opened = PosixPort(port, FORMAT)
            time.sleep(0.3)
            opened.close()
            time.sleep(0.1)
            written.append(int(host("heard", line).split()[0]))
        host("traffic", line, "off")
        some = [count for count in written if count]
        say(f"  {port}: {sum(written)} bytes written in {len(some)} of {OPENINGS} openings")
        again = []
        for _ in range(3):
            PosixPort(port, FORMAT).close()
            again.append(int(host("heard", line).split()[0]))
        if sum(again):
            yield f"{port}: a port that was raw before wrote {again}"


def modem_lines() -> Iterator[str]:
    """(d) DTR and RTS are raised by the kernel, and off where that is asked for."""
    both = termios.TIOCM_DTR | termios.TIOCM_RTS
    off = ModemLines(dtr=ModemLine.OFF, rts=ModemLine.OFF)
    for port in (UART, FTDI):
        for lines, wanted in ((ModemLines(), both), (off, 0)):
            opened = PosixPort(port, FORMAT, lines)
            answer = fcntl.ioctl(opened._fd, termios.TIOCMGET, bytes(4))
            found = struct.unpack("i", answer)[0] & both
            opened.close()
            say(f"  {port} {lines}: DTR and RTS are {found:#x}")
            if found != wanted:
                yield f"{port}: {lines} gives {found:#x}, not {wanted:#x}"


def timing() -> Iterator[str]:
    """(e, f) Bytes come at once while a port is open, and the settings are put back."""
    for port, file in (
        (UART, "/sys/class/tty/ttyS1/rx_trig_bytes"),
        (FTDI, "/sys/bus/usb-serial/devices/ttyUSB0/latency_timer"),
    ):
        before = Path(file).read_text().strip()
        opened = PosixPort(port, FORMAT)
        during = Path(file).read_text().strip()
        opened.close()
        after = Path(file).read_text().strip()
        say(f"  {file}: {before}, open {during}, then {after}")
        if during != "1" or after != before:
            yield f"{file}: {before}, while open {during}, then {after}"


def refusals() -> Iterator[str]:
    """(g) A port that cannot be opened is explained by slave as by sniff."""
    busy = PosixPort(FTDI, FORMAT)
    for port in ("/dev/ttyUSB7", "/dev/ttyS2", "/etc/passwd", FTDI):
        link = f"rtu:{port}@{FORMAT}"
        told = {
            mbtool("sniff", link).stderr.splitlines()[-1],
            mbtool("slave", "idec-ft1a-touch", "--on", link).stderr.splitlines()[-1],
        }
        say(f"  {' | '.join(told)}")
        if len(told) != 1:
            yield f"{port} is explained in two ways: {told}"
    busy.close()


def names() -> Iterator[str]:
    """(h) A name of 60 characters below /dev/serial/by-id does not break the table."""
    link = next(Path("/dev/serial/by-id").iterdir())
    host("traffic", "usb", "on")
    command = f"{sys.executable} -m mbtool sniff rtu:{link}@{FORMAT} --count 5"
    # A terminal of 80 columns; what goes into a pipe has no width.
    done = subprocess.run(
        ["script", "-qec", f"stty cols 80 rows 24; {command}", "/dev/null"],
        capture_output=True,
        text=True,
        check=False,
    )
    host("traffic", "usb", "off")
    say(done.stdout)
    rows = [line for line in done.stdout.splitlines() if "request -> response" in line]
    if not rows or any(len(line) > 100 for line in done.stdout.splitlines() if "->" in line):
        yield "the table is wider than 80 columns"  # 20 more are orders for the terminal.


def _await(lines: Any, word: str) -> None:
    for line in lines:
        say(f"  {line.rstrip()}")
        if word in line:
            return
    raise AssertionError(f"ended without saying {word!r}")


def say(text: str) -> None:
    sys.stdout.write(f"{text}\n")
    sys.stdout.flush()


CHECKS: dict[str, Callable[[], Iterator[str]]] = {
    "rates": rates,
    "echoes": echoes,
    "modem-lines": modem_lines,
    "timing": timing,
    "refusals": refusals,
    "names": names,
    "pulls": pulls,
}


def main() -> None:
    troubles = 0
    for name in sys.argv[2:] or CHECKS:
        say(f"{name}: {(CHECKS[name].__doc__ or '').splitlines()[0]}")
        try:
            for trouble in CHECKS[name]():
                troubles += 1
                say(f"  NOT RIGHT: {trouble}")
        except Exception as error:  # The other checks go on.
            troubles += 1
            say(f"  NOT RIGHT: {type(error).__name__}: {error}")
    say("all checks passed" if not troubles else f"{troubles} things are not right")
    sys.exit(1 if troubles else 0)


if __name__ == "__main__":
    main()
