"""Shows what decode looks like on real terminals: python -m tests.screens FOLDER [NAME...].

Makes the captures below in FOLDER, runs `mbtool decode` on them in tmux, in terminals of 80x24,
120x40 and 60x24, and into a pipe, and prints each screen as it stands at the end.
"""

from __future__ import annotations

import shlex
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from random import Random

from mbtool.devices import load_profile
from mbtool.slave.device.image import RegisterImage
from mbtool.slave.families import make_device
from tests.golden.findings_captures import Bus, Net
from tests.packets.building import SLAVE

REPOSITORY = Path(__file__).resolve().parents[1]
SIZES = ((80, 24), (120, 40), (60, 24))
PATIENCE_S = 60


@dataclass(frozen=True, slots=True)
class Shown:
    """A capture, and the options with which decode shows it."""

    make: Callable[[], bytes]
    options: tuple[str, ...] = ()

    def command(self, path: Path) -> list[str]:
        return [sys.executable, "-m", "mbtool", "decode", str(path), *self.options]


def ft1a_line() -> bytes:
    """A panel that is polled with four reads and written to; some requests ask too much."""
    device = make_device(load_profile("idec-ft1a-touch"), _image("idec-ft1a-touch", {0: 100}))
    polls = ["03 0000 0004", "04 0000 0002", "01 0000 000b", "02 0000 0008"]
    bus = Bus()
    for turn in range(12):
        asked = [*polls, f"06 0000 {4000 + turn:04x}"]
        if turn % 6 == 5:
            asked += ["03 0ffa 000a", "0F 0000 0003 01 05"]
        for request in asked:
            response = device.respond(1, bytes.fromhex(request), bus.now_ns)
            assert response is not None
            bus.asked(1, request, response.pdu.hex())
    return bus.file()


def units_in_turn() -> bytes:
    """Three units of a line, of which one is dead."""
    bus = Bus()
    for turn in range(20):
        for unit in (1, 2):
            bus.asked(unit, "03 0000 0002", f"03 04 {turn:04x} {unit:04x}")
        bus.frame(3, "03 0000 0002", after_ms=150)
        bus.now_ns += 300_000_000
    return bus.file()


def fa3_network() -> bytes:
    """An analog input module whose channels are polled; now and then one is switched on or off."""
    profile = load_profile("fa3-at1m8x")
    device = make_device(profile, RegisterImage.of(profile))
    net, chance = Net(), Random("fa3")
    talk = net.open()
    levels = [12000, 4000, 0, 0, 0, 2700, 0, 37]
    for turn in range(24):
        levels[0] += chance.randint(-3, 3)
        read = "04 10" + b"".join(one.to_bytes(2) for one in levels).hex()
        net.wait(100).asked(talk, "04 0002 0008", read, unit=0)
        requests = ["02 0010 0008"]
        if turn % 8 == 7:
            requests.append(f"06 0102 {0x5C + turn:04x}")
        for request in requests:
            response = device.respond(0, bytes.fromhex(request), net.now_ns)
            assert response is not None
            net.wait(100).asked(talk, request, response.pdu.hex(), unit=0)
    return net.file()


def scan() -> bytes:
    """A host that asks six slaves for what few of them have."""
    net, chance = Net(), Random("scan")
    talks = [net.open(40000 + host, slave=f"10.0.0.{host + 2}") for host in range(6)]
    for address in range(0, 1000, 100):
        for talk in talks:
            function = chance.choice((1, 2, 3, 4))
            code = chance.choice((1, 2, 2, 2, 4, 0x0B))
            answer = f"{function | 0x80:02x} {code:02x}"
            net.wait(7).asked(talk, f"{function:02x} {address:04x} 0001", answer)
    return net.file()


def registers() -> bytes:
    """Reads of 125 registers: counters, runs of equal values, and texts."""
    net, chance = Net(), Random("registers")
    talk = net.open()
    for turn in range(6):
        values = [chance.randrange(65536) for _ in range(125)]
        if turn % 2:
            values = [0] * 40 + values[:20] + [65535] * 65
        answer = "03 fa" + b"".join(one.to_bytes(2) for one in values).hex()
        net.wait(100).asked(talk, "03 0000 007d", answer)
    return net.file()


def bits() -> bytes:
    """Reads of 2,000 bits, by chance and nearly all 0."""
    net, chance = Net(), Random("bits")
    talk = net.open()
    for turn in range(6):
        data = chance.randbytes(250) if turn % 2 else bytes(100) + b"\x04" + bytes(149)
        net.wait(100).asked(talk, "01 0000 07d0", f"01 fa {data.hex()}")
    return net.file()


def points() -> bytes:
    """A controller whose measured values and settings have names."""
    profile = load_profile("chino-lt830")
    device = make_device(profile, RegisterImage.of(profile))
    bus = Bus()
    for turn in range(12):
        for request in ("04 0064 0008", "03 0000 000a", f"06 0001 {turn:04x}"):
            response = device.respond(2, bytes.fromhex(request), bus.now_ns)
            assert response is not None
            bus.asked(2, request, response.pdu.hex())
    return bus.file()


def _image(name: str, values: dict[int, int]) -> RegisterImage:
    return RegisterImage.of(load_profile(name))


SHOWN = {
    "ft1a-line": Shown(ft1a_line, ("--device", "1=idec-ft1a-touch")),
    "units-in-turn": Shown(units_in_turn),
    "fa3-network": Shown(fa3_network, ("--device", f"{SLAVE}=fa3-at1m8x")),
    "scan": Shown(scan),
    "registers": Shown(registers),
    "bits": Shown(bits),
    "points": Shown(points, ("--device", "2=chino-lt830")),
}


def screen(command: list[str], width: int, height: int) -> str:
    """What stands on a terminal of that size when the command has ended."""
    session = f"mbtool-{time.monotonic_ns()}"
    tmux = ["tmux", "-L", session, "-f", "/dev/null"]
    shell = f"clear; {shlex.join(command)} 2>/dev/null; tmux -L {session} wait -S done; sleep 60"
    size = ["-x", str(width), "-y", str(height)]
    subprocess.run([*tmux, "new-session", "-d", *size, "sh", "-c", shell], check=True)
    try:
        subprocess.run([*tmux, "set", "-g", "status", "off"], check=True)
        subprocess.run([*tmux, "resize-window", *size], check=True)
        subprocess.run([*tmux, "wait", "done"], check=True, timeout=PATIENCE_S)
        shown = subprocess.run(
            [*tmux, "capture-pane", "-p"], check=True, capture_output=True, text=True
        )
        return shown.stdout
    finally:
        subprocess.run([*tmux, "kill-server"], check=True)


def main(folder: Path, names: list[str]) -> None:
    for name, shown in SHOWN.items():
        if names and name not in names:
            continue
        path = folder / f"{name}.pcap"
        path.write_bytes(shown.make())
        for width, height in SIZES:
            _tell(f"{name} {width}x{height}", screen(shown.command(path), width, height))
        piped = subprocess.run(shown.command(path), check=True, capture_output=True, text=True)
        _tell(f"{name}, in a pipe", piped.stdout)


def _tell(title: str, text: str) -> None:
    sys.stdout.write(f"===== {title} {'=' * 40}\n{text}\n")


if __name__ == "__main__":
    main(Path(sys.argv[1]), sys.argv[2:])
