"""The options that limit the TCP connections to a slave that mbtool plays, and to a tap."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, ClassVar

import typer

from mbtool.cli.option_groups import OptionGroup
from mbtool.core.limits import (
    CONNECTIONS_PER_SECOND,
    SLAVE_CONNECTIONS,
    SLAVE_IDLE_S,
    TAP_CONNECTIONS,
    TAP_IDLE_S,
)

if TYPE_CHECKING:
    from mbtool.ports.tcp_listener import ConnectionLimits


@dataclass(frozen=True, slots=True)
class ConnectionOptions(OptionGroup):
    """Options that limit TCP connections: the number at once, the number of new ones per second,
    and the idle time.
    """

    heading: ClassVar[str] = "Connections"

    max_connections: Annotated[
        int | None,
        typer.Option(
            "--max-connections",
            metavar="N",
            min=1,
            help="The most masters connected over TCP at once. "
            f"[default: {SLAVE_CONNECTIONS} to a slave, or as many as its device takes; "
            f"{TAP_CONNECTIONS} to a tap]",
        ),
    ] = None
    max_rate: Annotated[
        float | None,
        typer.Option(
            "--max-rate",
            metavar="N",
            min=0.01,
            help=f"The most new TCP connections in a second. [default: {CONNECTIONS_PER_SECOND:g}]",
        ),
    ] = None
    idle: Annotated[
        float | None,
        typer.Option(
            "--idle",
            metavar="S",
            min=0.1,
            help="Close a TCP connection without a request, or a tap's without a byte, after so "
            f"many seconds. [default: {SLAVE_IDLE_S:g} of a slave, {TAP_IDLE_S:g} of a tap]",
        ),
    ] = None

    def read(self) -> ConnectionLimits:
        from mbtool.ports.tcp_listener import ConnectionLimits

        return ConnectionLimits(
            connections=self.max_connections, per_second=self.max_rate, idle_s=self.idle
        )
