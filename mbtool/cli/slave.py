"""mbtool slave: an embedded slave."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from mbtool.cli.options import RemoteOption


def slave(
    profile: Annotated[
        str,
        typer.Argument(
            metavar="PROFILE",
            help="A built-in profile (see mbtool devices), or the path of a TOML file.",
        ),
    ],
    on: Annotated[
        str,
        typer.Option(
            "--on",
            metavar="LINK",
            help="Where to answer: rtu:PORT@19200-8E1, ascii:PORT@9600-7E1, tcp:HOST:PORT or "
            "rtu+tcp:HOST:PORT.",
        ),
    ],
    unit: Annotated[
        int, typer.Option("--unit", metavar="UNIT", min=0, max=255, help="The unit to answer as.")
    ] = 1,
    image: Annotated[
        Path | None,
        typer.Option(
            "--image",
            metavar="FILE",
            help="A TOML file of start values by the device's references: HR400001 = 4660.",
        ),
    ] = None,
    allow_remote: RemoteOption = False,
) -> None:
    """Answer as a device does, until Ctrl-C.

    It has the areas, limits and exceptions of the device's manual, and keeps what is written to it.
    """
    from mbtool.cli.serve import serve
    from mbtool.core import parse_link
    from mbtool.core.link_spec import ANSWERED
    from mbtool.devices import load_profile
    from mbtool.workflows.serving import device_slave

    link = parse_link(on, ANSWERED)
    device = load_profile(profile)
    shell = device_slave(device, link, unit, image, allow_remote=allow_remote)
    serve(shell, f"{device.title} as unit {unit}")
