"""mbtool links: list the serial ports and interfaces of this machine."""

from __future__ import annotations

import json
import os
from collections.abc import Sequence
from dataclasses import asdict
from typing import TYPE_CHECKING, Annotated, Any

import typer

from mbtool.cli.options import ListFormat
from mbtool.cli.talk import say

if TYPE_CHECKING:
    from mbtool.core.local_ports import LocalInterface, LocalSerialPort


def links(
    format_: Annotated[ListFormat, typer.Option("--format", help="How to print.")] = "table",
) -> None:
    """List serial ports and interfaces, and what is in their way.

    For each the LINK to give, what would spoil its timing, who holds it, what is not permitted, and
    the command against it. Nothing is opened, and nothing is changed.
    """
    from mbtool.ports.local_ports import local_ports
    from mbtool.sources.local_interfaces import local_interfaces

    ports, interfaces = local_ports(), local_interfaces()
    if format_ == "jsonl":
        _print_json_lines(ports, interfaces)
    else:
        _print_tables(ports, interfaces)
    if not ports:
        say("no serial ports here; without hardware, mbtool line lays a virtual serial line")
    elif ports[0].unseen_processes:
        # In a container, not even root may examine the processes outside of it.
        hint = "" if _is_root() else "; sudo shows the ports that they hold"
        say(f"processes that could not be examined: {ports[0].unseen_processes}{hint}")


def _is_root() -> bool:
    return hasattr(os, "geteuid") and os.geteuid() == 0


def _print_tables(ports: Sequence[LocalSerialPort], interfaces: Sequence[LocalInterface]) -> None:
    from mbtool.cli.console import PipeConsole
    from mbtool.views.links import print_interfaces, print_ports

    console = PipeConsole()
    if ports:
        print_ports(console, ports)
        console.print()
    print_interfaces(console, interfaces)


def _print_json_lines(
    ports: Sequence[LocalSerialPort], interfaces: Sequence[LocalInterface]
) -> None:
    """Print one JSON object for each port and interface, without empty or unknown fields."""
    for port in ports:
        _print_json({"kind": "serial", "link": port.link, **_fields(port)})
    for one in interfaces:
        told = {"kind": "interface", "link": one.link, **_fields(one)}
        _print_json({**told, "may_capture": one.may_capture})


def _fields(here: LocalSerialPort | LocalInterface) -> dict[str, Any]:
    return asdict(
        here,
        dict_factory=lambda pairs: {
            key: value for key, value in pairs if value is not None and value != "" and value != ()
        },
    )


def _print_json(record: dict[str, Any]) -> None:
    # msgspec is not used: it fails on an interface name that is not UTF-8.
    typer.echo(json.dumps(record, separators=(",", ":")))
