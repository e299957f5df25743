"""Prints the serial ports and network interfaces of this machine, and what prevents their use."""

# Below the table of ports, each port has its LINK (the argument that other commands take) and its
# problems. Users copy a LINK or a command, so mbtool puts no line breaks into it: a narrow terminal
# wraps the line, and still copies it as one line.
#
# Names come from adapters, so they may contain markup or control characters; plain() makes them
# harmless.

from __future__ import annotations

from collections.abc import Sequence
from textwrap import wrap
from typing import TYPE_CHECKING

from mbtool.core.moments import counted
from mbtool.views.tables import plain, plain_table

if TYPE_CHECKING:
    from rich.console import Console

    from mbtool.core.local_ports import LocalInterface, LocalSerialPort, PortTrouble

_UNKNOWN = "-"
_INDENT = "  "
_NARROWEST = 20


def print_ports(console: Console, ports: Sequence[LocalSerialPort]) -> None:
    """Print a table of the ports, then for each port its LINK argument and its problems."""
    table = plain_table("port", "what it is", "driver", "timing", "low latency", "held by")
    for port in ports:
        table.add_row(
            plain(port.name),
            plain(_port_text(port)),
            plain(port.driver or _UNKNOWN),
            plain(_timing(port)),
            plain(_low_latency(port)),
            plain(_held_by(port)),
        )
    console.print(table)
    for port in ports:
        console.print()
        _print_whole(console, port.link, "bold")
        for trouble in port.troubles:
            _print_trouble(console, trouble)


def print_interfaces(console: Console, interfaces: Sequence[LocalInterface]) -> None:
    """Print a table of the interfaces, then each problem that prevents captures once."""
    table = plain_table("interface", "what it is", "state", "capture")
    for one in interfaces:
        table.add_row(
            plain(one.link),
            plain(one.description or _UNKNOWN),
            plain(_state(one)),
            plain("permitted" if one.may_capture else "no"),
        )
    console.print(table)
    about: dict[PortTrouble, list[str]] = {}
    for one in interfaces:
        for trouble in one.troubles:
            about.setdefault(trouble, []).append(one.name)
    for trouble, names in about.items():
        is_everywhere = len(names) == len(interfaces)
        _print_trouble(console, trouble, "" if is_everywhere else f"{', '.join(names)}: ")


def _print_trouble(console: Console, trouble: PortTrouble, where: str = "") -> None:
    for line in wrap(
        f"! {where}{trouble.problem}",
        max(console.width, _NARROWEST),
        initial_indent=_INDENT,
        subsequent_indent=2 * _INDENT,
    ):
        _print_whole(console, line, "yellow")
    if trouble.remedy:
        _print_whole(console, f"{2 * _INDENT}{trouble.remedy}")


def _print_whole(console: Console, line: str, style: str = "") -> None:
    console.print(plain(line, style), soft_wrap=True)


def _port_text(port: LocalSerialPort) -> str:
    usb = f"({port.usb_id})" if port.usb_id else ""
    return f"{port.description} {usb}".strip() or _UNKNOWN


def _timing(port: LocalSerialPort) -> str:
    if port.latency_timer_ms is not None:
        return f"timer {port.latency_timer_ms} ms"
    if port.fifo_bytes is not None:
        return f"FIFO {counted(port.fifo_bytes, 'byte')}"
    return _UNKNOWN


def _low_latency(port: LocalSerialPort) -> str:
    if port.low_latency:
        return "on"
    match port.low_latency_support:
        case None:
            return _UNKNOWN
        case True:
            return "when opened"
        case False:
            return "no"


def _held_by(port: LocalSerialPort) -> str:
    if port.holders:
        return ", ".join(map(str, port.holders))
    return "nobody seen" if port.unseen_processes else _UNKNOWN


def _state(one: LocalInterface) -> str:
    if one.is_up is None:
        return _UNKNOWN
    if not one.is_up:
        return "down"
    return "up, no cable" if one.has_carrier is False else "up"
