"""Measures reading whole files against peers: python -m tests.benchmarks.files [--packets N].

Makes the workloads of file_workloads.py, runs mbtool and the peers that are installed in turn, each
as a process of its own, and prints packets per second, processor time, peak memory, and how many
times faster than tshark (of each workload that it reads) by processor time: of the whole process,
and without start-up, which is the time for a capture without packets. With --plain mbtool runs as
if the extra `columns` were not installed. Absolute figures are the machine's; only ratios of one
run can be compared.
"""

from __future__ import annotations

import argparse
import os
import platform
import shutil
import statistics
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from tests.benchmarks.file_workloads import (
    Made,
    clean,
    dirty,
    make_capture,
    make_log,
    make_serial,
    per_poll,
)

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

PACKETS = 100_000
ROUNDS = 3

FIELDS = (
    "frame.number", "frame.time_epoch", "ip.src", "ip.dst", "tcp.stream", "mbtcp.trans_id",
    "mbtcp.unit_id", "modbus.func_code", "modbus.reference_num", "modbus.word_cnt",
    "modbus.exception_code", "modbus.regval_uint16",
)  # fmt: skip
"""The 12 fields that tshark prints."""

TSHARK = "tshark fields"


@dataclass(frozen=True, slots=True)
class Cost:
    """What one process needed."""

    seconds: float
    """Processor time, of the user and the system."""
    peak_mib: float


@dataclass(frozen=True, slots=True)
class FileMeasurement:
    """What one program needed for one workload: the median of all rounds."""

    workload: str
    program: str
    packets: int
    cost: Cost
    start_s: float = 0.0
    """Processor time, in s, for a capture without packets; 0 where that is not measured."""

    @property
    def net_s(self) -> float:
        """Processor time, in s, without start-up."""
        return max(self.cost.seconds - self.start_s, 0.01)


def measure(
    packets: int, rounds: int, folder: Path, only: Sequence[str] = ()
) -> Iterator[list[FileMeasurement]]:
    """Run each program on each workload; they take turns. Yields the figures of each workload."""
    for name, made in workloads(packets, folder, only):
        programs = programs_for(made, folder)
        empty: dict[str, list[str]] = {}
        if made.path.suffix == ".pcap":
            none = make_capture(folder / "empty.pcap", lambda *_: iter(()), 0)
            empty = programs_for(none, folder)
        costs: dict[str, list[Cost]] = {program: [] for program in programs}
        starts: dict[str, list[float]] = {program: [] for program in programs}
        for _ in range(rounds):
            for program, command in programs.items():
                costs[program].append(run(command))
                if program in empty:
                    starts[program].append(run(empty[program]).seconds)
        measured = []
        for program, found in costs.items():
            seconds = statistics.median(one.seconds for one in found)
            peak = max(one.peak_mib for one in found)
            start_s = statistics.median(starts[program] or [0.0])
            cost = Cost(seconds, peak)
            measured.append(FileMeasurement(name, program, made.packets, cost, start_s))
        yield measured


def workloads(packets: int, folder: Path, only: Sequence[str] = ()) -> Iterator[tuple[str, Made]]:
    """Make the workloads, or those of some names."""
    for name, frames in (("clean", clean), ("dirty", dirty), ("per-poll", per_poll)):
        if not only or name in only:
            yield name, make_capture(folder / f"{name}.pcap", frames, packets)
    if not only or "serial" in only:
        yield "serial", make_serial(folder / "serial.bin", packets)
    if not only or "log" in only:
        capture = make_capture(folder / "clean.pcap", clean, packets)
        yield "log", make_log(folder / "log.mcap", capture)


def programs_for(made: Made, folder: Path) -> dict[str, list[str]]:
    """The commands that read a workload, of those programs that are installed."""
    decode = [sys.executable, "-m", "mbtool", "decode", str(made.path), *made.options]
    programs = {
        "mbtool jsonl": [*decode, "--format", "jsonl"],
        "mbtool csv": [*decode, "--format", "csv"],
        "mbtool table": decode,
        "mbtool parquet": [*decode, "-o", str(folder / "out.parquet"), "--overwrite"],
    }
    tshark, suricata = shutil.which("tshark"), shutil.which("suricata")
    if made.path.suffix == ".pcap":
        for command in ("stats", "inventory", "check"):
            programs[f"mbtool {command}"] = [
                sys.executable,
                "-m",
                "mbtool",
                command,
                str(made.path),
            ]
        if tshark is not None:
            fields = [word for field in FIELDS for word in ("-e", field)]
            programs[TSHARK] = [tshark, "-r", str(made.path), "-T", "fields", *fields]
        if suricata is not None:
            programs["suricata"] = [suricata, "-r", str(made.path), "-l", str(folder)]
    return programs


def run(
    command: Sequence[str],
    codes: Sequence[int] = (0,),
) -> Cost:
    """Run a command to its end, and return what it needed.

    Raises RuntimeError if its exit code is not in `codes`.
    """
    with subprocess.Popen(
        command,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        stdin=subprocess.DEVNULL,
    ) as process:
        _, status, used = os.wait4(process.pid, 0)
        process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode not in codes:
        raise RuntimeError(f"{' '.join(command)}: exit code {process.returncode}")
    return Cost(used.ru_utime + used.ru_stime, used.ru_maxrss / 1024)


def report(measured: Sequence[FileMeasurement]) -> str:
    """A line for each program and workload."""
    tshark = {one.workload: one for one in measured if one.program == TSHARK}
    lines = [
        f"{'workload':<10}{'program':<16}{'packets':>10}{'s':>8}{'packets/s':>12}{'MiB':>7}"
        f"{'x tshark':>10}{'start s':>9}{'x without':>10}"
    ]
    for one in measured:
        reference = tshark.get(one.workload)
        ratio, net = "", ""
        if reference is not None:
            ratio = f"{reference.cost.seconds / one.cost.seconds:.1f}"
            net = f"{reference.net_s / one.net_s:.1f}"
        rate = one.packets / one.cost.seconds
        lines.append(
            f"{one.workload:<10}{one.program:<16}{one.packets:>10,}{one.cost.seconds:>8.2f}"
            f"{rate:>12,.0f}{one.cost.peak_mib:>7,.0f}{ratio:>10}{one.start_s:>9.2f}{net:>10}"
        )
    return "\n".join(lines) + "\n"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--packets", type=int, default=PACKETS, help="packets of each workload")
    parser.add_argument("--rounds", type=int, default=ROUNDS, help="the median of these counts")
    parser.add_argument("--only", action="append", default=[], help="a workload; repeatable")
    options = parser.parse_args()
    machine = f"{platform.machine()}, {os.cpu_count()} cores, Python {platform.python_version()}"
    sys.stdout.write(f"{machine}; for serial, packets are bytes\n")
    with tempfile.TemporaryDirectory() as folder:
        for measured in measure(options.packets, options.rounds, Path(folder), options.only):
            sys.stdout.write(report(measured))
            sys.stdout.flush()


if __name__ == "__main__":
    main()
