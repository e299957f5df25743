"""mbtool slave: an embedded slave."""

from __future__ import annotations

import re
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from mbtool.cli.options import AllowOption

if TYPE_CHECKING:
    from collections.abc import Sequence

    from mbtool.cli.output import RecordOutput
    from mbtool.workflows.shared.slave_monitor import SlaveMonitor

_OF_A_UNIT = re.compile(r"(\d{1,3})=(.+)", re.ASCII | re.DOTALL)


def slave(
    profile: Annotated[
        str,
        typer.Argument(
            metavar="PROFILE",
            help="A built-in profile (see mbtool devices), or the path of a TOML file.",
        ),
    ],
    on: Annotated[
        list[str],
        typer.Option(
            "--on",
            metavar="LINK",
            help="Where to answer: rtu:PORT@19200-8E1, ascii:PORT@9600-7E1, tcp:HOST:PORT or "
            "rtu+tcp:HOST:PORT.",
        ),
    ],
    unit: Annotated[
        list[str] | None,
        typer.Option(
            "--unit",
            metavar="UNIT[=PROFILE]",
            help="The unit to answer as, or with =PROFILE another device beside it on the same "
            "link. Repeatable. [default: 1]",
        ),
    ] = None,
    image: Annotated[
        list[str] | None,
        typer.Option(
            "--image",
            metavar="[UNIT=]FILE",
            help="A TOML file of values by the device's references or names, which stand or move: "
            "HR400001 = 4660; of another device with its unit in front. Repeatable.",
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
    fault: Annotated[
        Path | None,
        typer.Option("--fault", metavar="FILE", help="Spoil answers on purpose; docs/faults.md."),
    ] = None,
    print_: Annotated[
        bool,
        typer.Option(
            "--print", help="Show each request and its answer, as decode does, and the outputs."
        ),
    ] = False,
    allow: AllowOption = None,
) -> None:
    """Answer as a device does, or several, until Ctrl-C.

    It has the areas, limits and exceptions of the device's manual, keeps what is written to it, and
    does what docs/slave.md says.
    """
    from mbtool.cli.options import condition
    from mbtool.cli.output import open_output
    from mbtool.cli.serve import serve
    from mbtool.cli.talk import say
    from mbtool.core import UsageError, parse_link
    from mbtool.core.link_spec import ANSWERED
    from mbtool.devices import load_profile
    from mbtool.ports.allowed_peers import AllowedPeers
    from mbtool.workflows.shared.slave_monitor import SlaveMonitor
    from mbtool.workflows.slave import Station, device_slave

    if len(on) > 1:
        raise UsageError(f"--on {on[1]}: it answers on {on[0]} already; start another slave there")
    link = parse_link(on[0], ANSWERED)
    device = load_profile(profile)
    own, names = _units(unit or ())
    images = _images(image or (), own, names)
    others = {
        number: Station(load_profile(name), images.get(number)) for number, name in names.items()
    }
    exchanges = None
    if print_:
        exchanges = SlaveMonitor(device, link, {n: one.profile for n, one in others.items()})
    shell = device_slave(
        device,
        link,
        own,
        images.get(own),
        others=others,
        state_file=state,
        fault_file=fault,
        allowed=AllowedPeers.parse(allow or ()),
        exchanges=exchanges,
        on_trouble=lambda text: say(f"mbtool: {text}"),
    )
    devices = {own: device} | {number: one.profile for number, one in others.items()}
    who = ", ".join(f"{one.title} as unit {number}" for number, one in devices.items())
    if exchanges is None:
        serve(shell, who)
        return
    with open_output(None, None, None, exchanges.profile_for, condition(None)) as out:
        serve(shell, who, lambda: _show(exchanges, out))


def _show(exchanges: SlaveMonitor, out: RecordOutput) -> None:
    """Show what has come since the last time."""
    from mbtool.cli.talk import say

    for record in exchanges.records():
        out.add(record)
    out.wait()
    if missed := exchanges.missed():
        say(f"mbtool: {missed} more not shown: they come faster than they can be shown")
    if changed := exchanges.changed_outputs():
        say("outputs: " + ", ".join(f"{one.name} {one.text}" for one in changed))


def _units(texts: Sequence[str]) -> tuple[int, dict[int, str]]:
    """The device's own unit, and the profiles of others by theirs. Raises UsageError."""
    from mbtool.core import UsageError

    own: int | None = None
    others: dict[int, str] = {}
    for text in texts:
        of_a_unit = _OF_A_UNIT.fullmatch(text)
        digits = of_a_unit[1] if of_a_unit is not None else text
        if not (digits.isascii() and digits.isdecimal() and len(digits) <= 3 and int(digits) < 256):
            raise UsageError(
                f"--unit {text!r}: write a number from 0 to 255, or 3=PROFILE for another device"
            )
        if of_a_unit is not None:
            if int(digits) in others:
                raise UsageError(f"--unit {text}: unit {digits} is given two profiles; name one")
            others[int(digits)] = of_a_unit[2]
        elif own is not None:
            raise UsageError(
                f"--unit {text}: the device is unit {own} already; "
                f"write {text}=PROFILE for another one beside it"
            )
        else:
            own = int(digits)
    own = 1 if own is None else own
    if own in others:
        raise UsageError(
            f"--unit {own}={others[own]}: unit {own} is that of the first device; "
            f"choose another, or give the first one another with --unit N"
        )
    return own, others


def _images(texts: Sequence[str], own: int, others: dict[int, str]) -> dict[int, Path]:
    """The files of values by the unit that each is for. Raises UsageError."""
    from mbtool.core import UsageError

    images: dict[int, Path] = {}
    for text in texts:
        of_a_unit = _OF_A_UNIT.fullmatch(text)
        number = own if of_a_unit is None else int(of_a_unit[1])
        if number != own and number not in others:
            raise UsageError(f"--image {text}: no device is unit {number}; see --unit")
        if number in images:
            raise UsageError(f"--image {text}: unit {number} has a file already; join the two")
        images[number] = Path(text if of_a_unit is None else of_a_unit[2])
    return images
