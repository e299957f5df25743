"""Makes byte times of frames that PassiveModbusMonitor printed as text."""

from __future__ import annotations

import re
from datetime import UTC, datetime

from mbtool.core import SerialFormat
from mbtool.modbus import rtu_adu

_PRINTED = re.compile(
    r"(?P<time>\S+ \S+) (?:Read holding register| \* Response \d+ from) *(?:for )?device ID "
    r"(?P<unit>\d+) , (?:Start address = (?P<address>\d+) Quantity = (?P<quantity>\d+)"
    r"|data = (?P<value>\d+))"
)


def as_byte_times(printed: str) -> str:
    """The frames that PassiveModbusMonitor printed, as CSV with the times of their bytes.

    It prints a frame when its last byte has come: a request as one row, a response as one row for
    each register. The CRC is the one that a frame with this content must have.
    """
    frames: dict[str, tuple[int, bytes]] = {}
    for row in printed.splitlines():
        match = _PRINTED.fullmatch(row)
        assert match is not None, row
        unit, content = frames.get(match["time"], (int(match["unit"]), b""))
        numbers = (match["value"],) if match["value"] else (match["address"], match["quantity"])
        content += b"".join(int(number).to_bytes(2, "big") for number in numbers)
        frames[match["time"]] = unit, content
    rows = ["t_start_s,t_end_s,byte_hex"]
    character_s = SerialFormat(19200, 8, "E", 1).character_ns / 1e9
    for at, (unit, content) in frames.items():
        is_response = f"{at}  * Response" in printed
        count = bytes([len(content)]) if is_response else b""
        adu = rtu_adu(unit, b"\x03" + count + content)
        end_s = datetime.fromisoformat(at).replace(tzinfo=UTC).timestamp()
        for left, byte in zip(range(len(adu) - 1, -1, -1), adu, strict=True):
            last_s = end_s - left * character_s
            rows.append(f"{last_s - character_s:.6f},{last_s:.6f},{byte:02x}")
    return "\n".join(rows) + "\n"
