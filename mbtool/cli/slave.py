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
    state: Annotated[
        Path | None,
        typer.Option(
            "--state",
            metavar="FILE",
            help="Where the device's non-volatile registers are kept, from one start to the next.",
        ),
    ] = None,
    print_: Annotated[
        bool,
        typer.Option(
            "--print", help="Show each request and its answer, as decode does, and the outputs."
        ),
    ] = False,
    allow_remote: RemoteOption = False,
) -> None:
    """Answer as a device does, until Ctrl-C.

    It has the areas, limits and exceptions of the device's manual, and keeps what is written to it.
    An FA3 module has its rules for connections, resets, alarms and outputs, too: docs/slave.md.
    """
    from mbtool.cli.options import condition
    from mbtool.cli.output import open_output
    from mbtool.cli.serve import serve
    from mbtool.cli.talk import say
    from mbtool.core import parse_link
    from mbtool.core.link_spec import ANSWERED
    from mbtool.devices import load_profile
    from mbtool.workflows.exchanges import Exchanges
    from mbtool.workflows.serving import device_slave

    link = parse_link(on, ANSWERED)
    device = load_profile(profile)
    exchanges = Exchanges(device, link) if print_ else None
    shell = device_slave(
        device,
        link,
        unit,
        image,
        state_file=state,
        allow_remote=allow_remote,
        exchanges=exchanges,
        on_trouble=lambda text: say(f"mbtool: {text}"),
    )
    who = f"{device.title} as {'any unit' if device.any_unit else f'unit {unit}'}"
    if exchanges is None:
        serve(shell, who)
        return
    with open_output(None, None, None, exchanges.profile_for, condition(None)) as out:

        def look() -> None:
            for transaction in exchanges.transactions():
                out.add(transaction)
            out.wait()
            if missed := exchanges.missed():
                say(f"mbtool: {missed} more not shown: they come faster than they can be shown")
            if changed := exchanges.changed_outputs():
                say("outputs: " + ", ".join(f"{one.name} {one.text}" for one in changed))

        serve(shell, who, look)
