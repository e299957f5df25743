"""Options that several commands share, and what their texts mean."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from collections.abc import Sequence

    from mbtool.devices import Assignments
    from mbtool.workflows.where import Where

DeviceOption = Annotated[
    list[str] | None,
    typer.Option(
        "--device",
        metavar="WHO=PROFILE",
        help="Whose words to use: a unit (5), an address (192.168.3.250), both "
        "(192.168.3.250/5) or all; a built-in profile or the path of a TOML file. Repeatable.",
    ),
]
WhereOption = Annotated[
    str | None,
    typer.Option(
        "--where",
        metavar="EXPR",
        help='Only transactions for which this holds: "unit == 5 and latency_ms > 10".',
    ),
]
PortOption = Annotated[
    list[int] | None,
    typer.Option(
        "--port", min=1, max=65535, help="A TCP port of slaves. Repeatable. [default: 502]"
    ),
]
RtuPortOption = Annotated[
    list[int] | None,
    typer.Option(
        "--rtu-port",
        min=1,
        max=65535,
        help="A TCP port of slaves that speak RTU over TCP. Repeatable.",
    ),
]
RemoteOption = Annotated[
    bool,
    typer.Option(
        "--allow-remote",
        help="Listen also where other machines can connect; without it, on loopback only.",
    ),
]


def assignments(devices: Sequence[str] | None) -> Assignments:
    """The profiles that --device names. Raises UsageError, ProfileError."""
    from mbtool.devices import Assignments, parse_assignment

    return Assignments(parse_assignment(one) for one in devices or ())


def condition(where: str | None) -> Where:
    """The filter that --where names. Raises UsageError."""
    if where is None:
        return lambda _: True
    from mbtool.workflows.where import parse_where

    return parse_where(where)
