"""Writes one conversation in the forms in which programs log Modbus."""

# The forms are written from what these programs print; no line is another's.

from __future__ import annotations

from datetime import UTC, datetime
from typing import TYPE_CHECKING, NamedTuple

from mbtool.modbus import ascii_adu, mbap_adu, rtu_adu

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

BEGIN_S = 1_705_752_000
"""2024-01-20 12:00:00 UTC, a Saturday."""

PDUS = (
    ("03 006b 0003", "03 06 0190 01f4 0226"),
    ("06 0001 000b", "06 0001 000b"),
    ("10 0001 0002 04 000a 0102", "10 0001 0002"),
    ("04 0008 0001", "84 02"),
    ("01 0013 0013", "01 03 cd6b 05"),
    ("05 00ac ff00", "05 00ac ff00"),
    ("03 0000 0002", None),
    ("03 0000 0002", "03 04 1234 5678"),
)
"""Requests and responses of unit 1; None for a request without a response, which is repeated."""


class Said(NamedTuple):
    """A frame, who sent it, and when."""

    is_request: bool
    data: bytes
    ms: int

    @property
    def time(self) -> datetime:
        return datetime.fromtimestamp(BEGIN_S + self.ms / 1000, UTC)


def conversation(form: str = "rtu") -> list[Said]:
    """The frames of PDUS as RTU, ASCII or Modbus/TCP."""
    said = []
    for number, (request, response) in enumerate(PDUS, 1):
        for is_request, text in ((True, request), (False, response)):
            if text is None:
                continue
            pdu = bytes.fromhex(text)
            match form:
                case "rtu":
                    data = rtu_adu(1, pdu)
                case "ascii":
                    data = ascii_adu(1, pdu)
                case _:
                    data = mbap_adu(number, 1, pdu)
            said.append(Said(is_request, data, 1000 * number + (0 if is_request else 57)))
    return said


def expected() -> list[tuple[int, str]]:
    """The function and the outcome of each transaction of `conversation`."""
    outcomes = []
    for request, response in PDUS:
        function = int(request[:2], 16)
        if response is None:
            outcomes.append((function, "no-answer"))
        else:
            is_exception = bytes.fromhex(response)[0] & 0x80
            outcomes.append((function, "exception" if is_exception else "ok"))
    return outcomes


def _spaced(data: bytes) -> str:
    return data.hex(" ")


def _upper(data: bytes) -> str:
    return data.hex(" ").upper()


def _short_prefixed(data: bytes) -> str:
    return " ".join(f"{byte:#x}" for byte in data)


def _iso(one: Said, mark: str = ".") -> str:
    return f"{one.time:%Y-%m-%d %H:%M:%S}{mark}{one.time.microsecond // 1000:03d}"


def pymodbus(said: Sequence[Said], logger: str = "pymodbus.logging") -> str:
    """Prints a response twice, and so does an integration of Home Assistant."""
    lines = []
    for one in said:
        head = f"{_iso(one)} DEBUG (MainThread) [{logger}]"
        if one.is_request:
            lines += [
                f"{head} Current transaction state - IDLE",
                f"{head} Running transaction {one.ms}",
                f"{head} SEND: {_short_prefixed(one.data)}",
            ]
        else:
            lines += [
                f"{head} RECV: {_short_prefixed(one.data)}",
                f"{head} Processing: {_short_prefixed(one.data)}",
                f"{head} Getting transaction {one.ms}",
            ]
    return "\n".join(lines)


def pymodbus_pieces(said: Sequence[Said]) -> str:
    """Responses come in two reads, and the second line repeats the first piece."""
    lines = []
    for one in said:
        head = f"{_iso(one, ',')} DEBUG logging:103"
        if one.is_request:
            lines.append(f"{head} send: {_short_prefixed(one.data)}")
            continue
        first, second = one.data[:3], one.data[3:]
        lines += [
            f"{head} recv: {_short_prefixed(first)} old_data:  addr=None",
            f"{head} Processing: {_short_prefixed(first)}",
            f"{head} recv: {_short_prefixed(second)} old_data: {_short_prefixed(first)} addr=None",
            f"{head} Processing: {_short_prefixed(one.data)}",
        ]
    return "\n".join(lines)


def libmodbus(said: Sequence[Said]) -> str:
    lines = ["-- Polling slave 1..."]
    for one in said:
        opening, closing = "[]" if one.is_request else "<>"
        lines.append("".join(f"{opening}{byte:02X}{closing}" for byte in one.data))
        if one.is_request:
            lines.append("Waiting for a confirmation...")
    return "\n".join(lines)


def libmodbus_slave(said: Sequence[Said]) -> str:
    """A slave receives requests: the same brackets, the other way round."""
    lines = []
    for one in said:
        if one.is_request:
            lines.append("Waiting for an indication...")
        opening, closing = "<>" if one.is_request else "[]"
        lines.append("".join(f"{opening}{byte:02X}{closing}" for byte in one.data))
    return "\n".join(lines)


def esphome(said: Sequence[Said]) -> str:
    return "\n".join(
        f"\x1b[0;36m[{one.time:%H:%M:%S}][D][uart_debug:114]: "
        f"{'>>>' if one.is_request else '<<<'} {one.data.hex(':').upper()}\x1b[0m"
        for one in said
    )


def go_client(said: Sequence[Said]) -> str:
    return "\n".join(
        f"[modbus-1] TRACE {one.time:%Y/%m/%d %H:%M:%S} modbus: "
        f"{'sending' if one.is_request else 'received'} {_spaced(one.data)}"
        for one in said
    )


def minimal(said: Sequence[Said]) -> str:
    """Shows bytes as a text of Python, and in hexadecimal beside it."""
    return "\n".join(
        f"MinimalModbus debug mode. {'Writing to' if one.is_request else 'Response from'} "
        f"instrument: {repr(one.data)[1:]} ({_upper(one.data)}) ({len(one.data)} bytes)"
        for one in said
    )


def poll_window(said: Sequence[Said]) -> str:
    return "\n".join(
        f"{'Tx' if one.is_request else 'Rx'}:{number:06d}-{_upper(one.data)}"
        for number, one in enumerate(said)
    )


def bus_monitor(said: Sequence[Said]) -> str:
    return "\n".join(
        f"[RTU]>{'Tx' if one.is_request else 'Rx'} > {one.time:%H:%M:%S}:"
        f"{one.time.microsecond // 1000:03d} - {'  '.join(f'{byte:02X}' for byte in one.data)}  "
        for one in said
    )


def arrows(said: Sequence[Said]) -> str:
    return "\n".join(
        f"{'→' if one.is_request else '←'} < {_spaced(one.data)} > {len(one.data)} bytes"
        for one in said
    )


def tasmota(said: Sequence[Said]) -> str:
    return "\n".join(
        f"{one.time:%H:%M:%S}.{one.time.microsecond // 1000:03d} MBS: Serial "
        f"{'sent' if one.is_request else 'received'} {one.data.hex().upper()}"
        for one in said
    )


def gateway(said: Sequence[Said]) -> str:
    return "\n".join(
        f"{one.time:%d %b %Y %H:%M:%S} tty: {'request' if one.is_request else 'response'}: "
        + "".join(f"[{byte:02x}]" for byte in one.data)
        for one in said
    )


def node(said: Sequence[Said]) -> str:
    """An object over several lines; its first line has the direction."""
    lines = []
    for one in said:
        what = "send serial rtu buffered" if one.is_request else "receive serial rtu buffered port"
        lines += [
            f"  modbus-serial {{ action: '{what}',",
            f"  data: <Buffer {_spaced(one.data)}>,",
            "  unitid: 1 } +2ms",
        ]
    return "\n".join(lines)


def docklight(said: Sequence[Said]) -> str:
    return "\n\n".join(
        f"{one.time:%d.%m.%Y %H:%M:%S}.{one.time.microsecond // 1000:03d} "
        f"[{'TX' if one.is_request else 'RX'}] - {_upper(one.data)} "
        for one in said
    )


def terminal(said: Sequence[Said]) -> str:
    """Nothing but bytes, without an end of frames."""
    text = " ".join(_upper(one.data) for one in said)
    return "\n".join(text[at : at + 48] for at in range(0, len(text), 48))


def irp(said: Sequence[Said]) -> str:
    lines = []
    for number, one in enumerate(said):
        kind = "IRP_MJ_WRITE" if one.is_request else "IRP_MJ_READ"
        lines.append(f"{number:06d}: {_iso(one)} +0.0123 {kind} DOWN COM3 STATUS_SUCCESS")
        lines += dump_rows(one.data)
    return "\n".join(lines)


def per_byte(said: Sequence[Said]) -> str:
    """A line for each byte, with an arrow."""
    return "\n".join(
        f"{'>' if one.is_request else '<'}\t{byte:#04x} ({chr(byte) if 32 < byte < 127 else '.'})"
        for one in said
        for byte in one.data
    )


def dump_rows(data: bytes, *, offset: int = 0) -> list[str]:
    rows = []
    for at in range(0, len(data), 16):
        row = data[at : at + 16]
        pairs = _spaced(row[:8]) + ("  " + _spaced(row[8:]) if len(row) > 8 else "")
        shown = "".join(chr(byte) if 32 <= byte < 127 else "." for byte in row)
        rows.append(f"{offset + at:08x}  {pairs:<48}  |{shown}|")
    return rows


def headed(said: Sequence[Said]) -> str:
    """A heading with time and port, then rows with a column of characters."""
    lines = []
    for one in said:
        lines.append(f"{_iso(one)}: {'/dev/ttyS0 tx' if one.is_request else '/dev/ttyS1 rx'}")
        for at in range(0, len(one.data), 16):
            row = one.data[at : at + 16]
            shown = "".join(chr(byte) if 32 <= byte < 127 else "." for byte in row)
            lines.append(f"{_upper(row):<48} {shown}")
    return "\n".join(lines)


def socat(said: Sequence[Said]) -> str:
    lines = []
    for one in said:
        lines += [
            f"{'>' if one.is_request else '<'} {one.time:%Y/%m/%d %H:%M:%S}."
            f"{one.time.microsecond:06d}  length={len(one.data)} from=0 to={len(one.data) - 1}",
            f" {_spaced(one.data)}",
            "--",
        ]
    return "\n".join(lines)


def system_calls(said: Sequence[Said]) -> str:
    lines = []
    for one in said:
        text = "".join(
            chr(byte) if 32 <= byte < 127 and chr(byte) not in '"\\' else f"\\{byte:03o}"
            for byte in one.data
        )
        call = "write" if one.is_request else "read"
        size = len(one.data)
        lines += [
            f"{one.time.timestamp():.6f} select(4, [3], NULL, NULL, {{tv_sec=1}}) = 1",
            f'{one.time.timestamp():.6f} {call}(3, "{text}", {size}) = {size}',
        ]
    return "\n".join(lines)


def hexdump(said: Sequence[Said]) -> str:
    data = b"".join(one.data for one in said)
    return "\n".join([*dump_rows(data), f"{len(data):08x}"])


def xxd(said: Sequence[Said]) -> str:
    data = b"".join(one.data for one in said)
    rows = []
    for at in range(0, len(data), 16):
        row = data[at : at + 16]
        groups = " ".join(row[two : two + 2].hex() for two in range(0, len(row), 2))
        rows.append(f"{at:08x}: {groups:<39}  {'.' * len(row)}")
    return "\n".join(rows)


def samples(said: Sequence[Said]) -> str:
    """A byte in each line, with the numbers of its samples."""
    lines = []
    at = 1000
    for one in said:
        for byte in one.data:
            lines.append(f"{at}-{at + 500} UART: {'TX' if one.is_request else 'RX'}: {byte:02X}")
            at += 520
        at += 20_000
    return "\n".join(lines)


def table(said: Sequence[Said]) -> str:
    return "\n".join(
        [
            "time,direction,data",
            *(
                f'{one.ms / 1000:.6f},{"TX" if one.is_request else "RX"},"{_upper(one.data)}"'
                for one in said
            ),
        ]
    )


def python_bytes(said: Sequence[Said]) -> str:
    return "\n".join(f"INFO:root:{'tx' if one.is_request else 'rx'} {one.data!r}" for one in said)


def decimals(said: Sequence[Said]) -> str:
    return "\n".join(
        f"{'request' if one.is_request else 'response'} = {[*one.data]}" for one in said
    )


def kernel(said: Sequence[Said]) -> str:
    return "\n".join(
        f"[{one.ms / 1000 + 4567:12.6f}] rs485 {'tx' if one.is_request else 'rx'} "
        f"{one.data.hex('-')} len {len(one.data)}"
        for one in said
    )


def device(said: Sequence[Said]) -> str:
    """Milliseconds since the boot of a device."""
    return "\n".join(
        f"{one.ms} ms {'-->' if one.is_request else '<--'} "
        + ", ".join(f"0x{byte:02X}" for byte in one.data)
        for one in said
    )


def container(said: Sequence[Said]) -> str:
    """Lines of JSON around the lines of a program."""
    return "\n".join(
        f'{{"log":"{"SEND" if one.is_request else "RECV"}: {_spaced(one.data)}\\n","stream":'
        f'"stderr","time":"{one.time:%Y-%m-%dT%H:%M:%S}.{one.time.microsecond:06d}123Z"}}'
        for one in said
    )


def syslog(said: Sequence[Said]) -> str:
    return "\n".join(
        f"{one.time:%b %d %H:%M:%S} plc4 poller[812]: {'W' if one.is_request else 'R'} "
        f"{'req' if one.is_request else 'rsp'} {'h '.join(f'{b:02X}' for b in one.data)}h"
        for one in said
    )


def powershell(said: Sequence[Said]) -> str:
    return "\r\n".join(
        f"{one.time:%H:%M:%S} {'Sent' if one.is_request else 'Received'}: {one.data.hex('-')}"
        for one in said
    )


def listed(said: Sequence[Said]) -> str:
    """Decimal numbers without brackets, as libraries for .NET write them."""
    return "\n".join(
        f"Transport - {'TX' if one.is_request else 'RX'}: {', '.join(map(str, one.data))}"
        for one in said
    )


def dashed(said: Sequence[Said]) -> str:
    """Decimal numbers between dashes, as a library for Python writes them."""
    return "\n".join(
        f"{_iso(one, ',')}\tDEBUG\texecute\t{'->' if one.is_request else '<-'} "
        + "-".join(map(str, one.data))
        for one in said
    )


def piped(said: Sequence[Said]) -> str:
    """A dump whose offset and characters are behind bars."""
    lines = []
    for one in said:
        lines.append(f"{_iso(one)} INFO | bus | {'sent' if one.is_request else 'received'} data")
        for at in range(0, len(one.data), 16):
            row = one.data[at : at + 16]
            lines.append(f"  {at:04x} | {row.hex(' '):<48} | {'.' * len(row)}")
    return "\n".join(lines)


_FORMS: tuple[Callable[[Sequence[Said]], str], ...] = (
    pymodbus, pymodbus_pieces, libmodbus, libmodbus_slave, esphome, go_client, minimal,
    poll_window, bus_monitor, arrows, tasmota, gateway, node, docklight, terminal, irp, per_byte,
    headed, socat, system_calls, hexdump, xxd, samples, table, python_bytes, decimals, kernel,
    device, container, syslog, powershell, listed, dashed,
    piped,
)  # fmt: skip
FORMS = {each.__name__: each for each in _FORMS}
TIMED = {
    "pymodbus", "pymodbus_pieces", "esphome", "go_client", "bus_monitor", "tasmota", "gateway",
    "docklight", "irp", "headed", "socat", "system_calls", "table", "kernel", "device",
    "container", "syslog", "powershell", "dashed", "piped",
}  # fmt: skip
"""The forms that have times."""
BY_WORD = set(FORMS) - {"terminal", "hexdump", "xxd"}
"""The forms that say who sent."""
