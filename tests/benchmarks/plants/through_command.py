"""Has `mbtool decode` read a plant from a file, and compares the result with that of the class."""

# The file is what a capture of such an adapter is: byte times as a logic analyser writes them
# (exact), a log with the chunks that were read (all that deliver blocks), or the bytes alone.

from __future__ import annotations

import json
import subprocess
import sys
from typing import TYPE_CHECKING, Any

from mbtool.core import Chunk
from mbtool.logs import LogWriter
from mbtool.modbus import Transaction, Verdict
from tests.benchmarks.plants.decoding import decoded
from tests.benchmarks.plants.delivery import Adapter, delivered

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from tests.benchmarks.plants.recording import Recording

LINK = "plant"
Said = tuple[str | None, str | None, str, float, bool]
"""The request and the response in hexadecimal, the outcome, the confidence, if it is ambiguous."""


def differences(recording: Recording, adapter: Adapter, folder: Path) -> list[str]:
    """Where the command and the class disagree, in words."""
    by_command = list(_by_command(recording, adapter, folder))
    by_class = list(_by_class(recording, adapter))
    found = [
        f"transaction {place}: the command says {said}, the class {known}"
        for place, (said, known) in enumerate(zip(by_command, by_class, strict=False))
        if said != known
    ]
    if len(by_command) != len(by_class):
        found.append(f"the command tells {len(by_command)} transactions, the class {len(by_class)}")
    return found


def _by_class(recording: Recording, adapter: Adapter) -> Iterator[Said]:
    reads = delivered(recording, adapter)
    for one in decoded(recording.line, reads, timed=adapter is not Adapter.NO_TIMES):
        if isinstance(one, Transaction):
            request, response = (
                None if raw is None else raw.hex() for raw in (one.request_raw, one.response_raw)
            )
            is_ambiguous = Verdict.AMBIGUOUS in one.verdicts
            yield request, response, str(one.outcome), one.confidence, is_ambiguous


def _by_command(recording: Recording, adapter: Adapter, folder: Path) -> Iterator[Said]:
    path, options = written(recording, adapter, folder)
    command = [sys.executable, "-m", "mbtool", "decode", str(path)]
    command += ["--format", "jsonl", "--events", "all", *options]
    done = subprocess.run(command, check=True, capture_output=True, text=True)
    for row in done.stdout.splitlines():
        one: dict[str, Any] = json.loads(row)
        if "outcome" in one:
            yield (
                one.get("request_raw"),
                one.get("response_raw"),
                one["outcome"],
                one["confidence"],
                str(Verdict.AMBIGUOUS) in one.get("verdicts", ()),
            )


def written(recording: Recording, adapter: Adapter, folder: Path) -> tuple[Path, list[str]]:
    """Write the file of a capture; its path, and the options that `decode` needs for it."""
    line = ["--link", f"rtu@{recording.line}"]
    match adapter:
        case Adapter.NO_TIMES:
            path = folder / f"{LINK}.raw"
            path.write_bytes(recording.data)
            return path, line
        case Adapter.EXACT:
            path = folder / f"{LINK}.csv"
            path.write_text(_byte_times(recording))
            return path, line
        case _:
            path = folder / f"{LINK}.mcap"
            with LogWriter(path, capture={}, replace=True) as log:
                log.add_link(LINK, {"spec": f"rtu:/dev/{LINK}@{recording.line}"})
                for data, ts_ns in delivered(recording, adapter):
                    log.write(Chunk(ts_ns=ts_ns, link=LINK, data=data))
            return path, ["--raw"]


def _byte_times(recording: Recording) -> str:
    character_ns = recording.line.character_ns
    rows = ["t_start_s,t_end_s,byte_hex"]
    for byte, end_ns in zip(recording.data, recording.times, strict=True):
        rows.append(f"{_seconds(end_ns - character_ns)},{_seconds(end_ns)},{byte:02x}")
    return "\n".join(rows) + "\n"


def _seconds(ns: int) -> str:
    return f"{ns // 10**9}.{ns % 10**9:09}"
