"""Measures how many packets a live capture loses, beside tcpdump.

`python -m tests.benchmarks.live_capture` prints what 20,000 packets a second for 10 s cost, whether
the loss that the log tells is exact, and the highest rate without loss of mbtool and of tcpdump.
"""

# The two ends of a veth pair are in namespaces of their own (tests/end_to_end/namespaces.py), so it
# needs root. At one end a process sends reads of holding registers and their answers, one Modbus
# connection, at a steady rate from a raw socket; at the other `mbtool sniff net:` logs and decodes
# them, or tcpdump writes them, one after the other. The loss is exact when the packets in the log
# and those that its events tell as lost are together those that were sent.
#
# A rate that the sender itself did not reach on this machine ends the search.

from __future__ import annotations

import re
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from mbtool.core import EventKind, Packet, WireEvent
from mbtool.logs import LogReader
from mbtool.modbus import mbap_adu
from tests.end_to_end.namespaces import INTERFACE, cable, why_not
from tests.end_to_end.programs import MBTOOL
from tests.packets.building import Talk

if TYPE_CHECKING:
    from collections.abc import Sequence

    from tests.end_to_end.namespaces import Cable

RATE, SECONDS = 20_000, 10.0
RATES = (10_000, 20_000, 40_000, 60_000, 80_000, 120_000, 160_000)
RATE_SECONDS = 3.0
PATIENCE_S = 300.0
_REACHED = 0.97
_BURST_S = 0.001

READ = bytes.fromhex("03 0000 0002")
VALUES = bytes.fromhex("03 04 1234 5678")
_IPV4 = b"\x08\x00"
_SEQUENCES = slice(38, 46)
"""Where sequence number and acknowledgement stand: behind 14, 20 and 4 bytes."""


@dataclass(frozen=True, slots=True)
class Result:
    """What became of the packets of one run."""

    who: str
    rate: int
    sent: int
    sent_s: float
    captured: int
    told: int
    """How many packets the program said that it lost."""

    @property
    def lost(self) -> int:
        return self.sent - self.captured

    @property
    def is_exact(self) -> bool:
        return self.lost == self.told

    @property
    def is_reached(self) -> bool:
        return self.sent / self.sent_s >= _REACHED * self.rate


def send(rate: int, seconds: float) -> None:
    """Send from a raw socket, and print how many packets in how many seconds."""
    talk = Talk()
    request, response = (
        bytearray(packet.data)
        for packet in (
            talk.request(mbap_adu(1, 1, READ)),
            talk.response(mbap_adu(1, 1, VALUES)),
        )
    )
    asked, answered = len(mbap_adu(1, 1, READ)), len(mbap_adu(1, 1, VALUES))
    port = socket.socket(socket.AF_PACKET, socket.SOCK_RAW)
    port.bind((INTERFACE, 0))
    total, sent = round(rate * seconds) // 2 * 2, 0
    masters = slaves = 1000
    began = time.perf_counter()
    while sent < total:
        due = min(total, int((time.perf_counter() - began) * rate))
        while sent < due:
            request[_SEQUENCES] = (masters << 32 | slaves).to_bytes(8)
            port.send(request)
            masters = masters + asked & 0xFFFFFFFF
            response[_SEQUENCES] = (slaves << 32 | masters).to_bytes(8)
            port.send(response)
            slaves = slaves + answered & 0xFFFFFFFF
            sent += 2
        time.sleep(_BURST_S)
    sys.stdout.write(f"{sent} {time.perf_counter() - began}\n")


def measure(ends: Cable, who: str, rate: int, seconds: float, folder: Path) -> Result:
    """Send and capture once. Everything is decoded before the figures are taken."""
    path = folder / f"{who}-{rate}-{seconds:.0f}"
    capture = _start(ends, who, path)
    try:
        command = (sys.executable, "-m", __spec__.name, "send", str(rate), str(seconds))
        sender = subprocess.run(
            ends.within(ends.master, *command), check=True, capture_output=True, text=True
        )
        time.sleep(1.5)  # The kernel's count is read every second.
        capture.send_signal(signal.SIGINT)
        _, said = capture.communicate(timeout=PATIENCE_S)
    finally:
        capture.kill()
    sent, took = sender.stdout.split()
    if who == "tcpdump":
        captured, told = (
            int(re.search(rf"(\d+) packets {what}", said)[1])  # type: ignore[index]
            for what in ("captured", "dropped by kernel")
        )
    else:
        captured, told = logged(path.with_suffix(".mcap"))
    return Result(who, rate, int(sent), float(took), captured, told)


def logged(path: Path) -> tuple[int, int]:
    """How many packets a log has, and how many it says were lost."""
    captured = told = 0
    with path.open("rb") as file:
        for item in LogReader(file, str(path)).items():
            if isinstance(item, Packet):
                captured += item.data[12:14] == _IPV4  # IPv6's own talk passes the filter, too.
            elif isinstance(item, WireEvent) and item.kind is EventKind.DISCARDED:
                told += item.packets
    return captured, told


def _start(ends: Cable, who: str, path: Path) -> subprocess.Popen[str]:
    if who == "tcpdump":
        command: Sequence[str] = (
            *("tcpdump", "-i", INTERFACE, "-B", "32768", "-w", f"{path}.pcap", "-Z", "root"),
            "tcp port 502",
        )
    else:
        command = (MBTOOL, "sniff", f"net:{INTERFACE}", "-w", f"{path}.mcap", "--format", "jsonl")
    process = subprocess.Popen(
        ends.within(ends.slave, *command),
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
    )
    assert process.stderr is not None
    for line in process.stderr:
        if "listening on" in line:
            break
    return process


def report(results: Sequence[Result]) -> str:
    """One line for each run."""
    lines = [f"{'capture':<10}{'rate/s':>9}{'sent':>9}{'lost':>9}{'told':>9}  loss told"]
    lines += [
        f"{one.who:<10}{one.rate:>9}{one.sent:>9}{one.lost:>9}{one.told:>9}  "
        f"{'exactly' if one.is_exact else 'WRONGLY'}"
        f"{'' if one.is_reached else '; the sender was slower'}"
        for one in results
    ]
    return "\n".join(lines)


def highest(ends: Cable, who: str, folder: Path) -> tuple[int, list[Result]]:
    """The highest of RATES without a lost packet, and how each went."""
    best, results = 0, []
    for rate in RATES:
        results.append(measure(ends, who, rate, RATE_SECONDS, folder))
        if results[-1].lost or not results[-1].is_reached:
            break
        best = rate
    return best, results


def main() -> int:
    """Print the figures; the answer is 1 where a loss was told wrongly."""
    reason = why_not()
    if reason is not None:
        sys.stdout.write(f"{reason}\n")
        return 3
    with tempfile.TemporaryDirectory() as folder, cable() as ends:
        named = measure(ends, "mbtool", RATE, SECONDS, Path(folder))
        _print(report([named]))
        results = [named]
        for who in ("mbtool", *(("tcpdump",) if shutil.which("tcpdump") else ())):
            best, runs = highest(ends, who, Path(folder))
            _print(f"\n{report(runs)}\n{who}: no packet lost at {best} packets a second")
            results += runs if who == "mbtool" else []
    return int(not all(one.is_exact for one in results))


def _print(text: str) -> None:
    sys.stdout.write(f"{text}\n")
    sys.stdout.flush()


if __name__ == "__main__":
    if sys.argv[1:2] == ["send"]:
        send(int(sys.argv[2]), float(sys.argv[3]))
        sys.exit(0)
    if sys.argv[1:]:
        sys.exit(__doc__)
    sys.exit(main())
