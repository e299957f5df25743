"""Writes recordings: the bytes of lines as CSV or pcap, the packets of networks as pcap."""

from __future__ import annotations

import struct
from typing import TYPE_CHECKING

from tests.adversary.illnesses.wire import MS, SECOND

if TYPE_CHECKING:
    from collections.abc import Iterable
    from pathlib import Path

    from tests.adversary.illnesses.wire import Heard, Settings

EXACT, POLLED, FTDI = "exact", "1 ms", "FTDI"
TIMINGS = (EXACT, POLLED, FTDI)
START_NS = 1_700_000_000 * SECOND
FTDI_NS, FTDI_BYTES = 16 * MS, 62
USER0, ETHERNET = 147, 1


def write_line(path: Path, told: Heard, settings: Settings, timing: str) -> list[str]:
    """Write what was heard of a line; return the arguments with which to read it."""
    if timing == EXACT:
        path = path.with_suffix(".csv")
        rows = ["t_start_s,t_end_s,byte_hex"]
        for at_ns, byte in told:
            end_ns = at_ns + settings.character_ns
            rows.append(f"{at_ns / SECOND:.9f},{end_ns / SECOND:.9f},{byte:02x}")
        path.write_text("\n".join(rows) + "\n")
        return [str(path)]
    path = path.with_suffix(".pcap")
    write_pcap(path, _reads(told, settings, timing), USER0)
    return [str(path), "--link", f"rtu@{settings.baud}-8{settings.parity}1"]


def write_pcap(path: Path, packets: Iterable[tuple[int, bytes]], link_type: int = ETHERNET) -> None:
    with path.open("wb") as file:
        file.write(struct.pack("<IHHiIII", 0xA1B23C4D, 2, 4, 0, 0, 65535, link_type))
        for at_ns, data in packets:
            seconds, rest = divmod(START_NS + at_ns, SECOND)
            file.write(struct.pack("<IIII", seconds, rest, len(data), len(data)) + data)


def _reads(told: Heard, settings: Settings, timing: str) -> Iterable[tuple[int, bytes]]:
    tick_ns = MS if timing == POLLED else FTDI_NS
    data, due_ns = bytearray(), 0
    for at_ns, byte in told:
        end_ns = at_ns + settings.character_ns
        if data and (end_ns > due_ns or len(data) >= FTDI_BYTES):
            yield min(due_ns, end_ns), bytes(data)
            data.clear()
        if not data:
            due_ns = (end_ns // tick_ns + 1) * tick_ns
        data.append(byte)
    if data:
        yield due_ns, bytes(data)
