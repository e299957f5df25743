"""mbtool slave: answer requests as a device does."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from mbtool.cli.connection_options import ConnectionOptions
from mbtool.cli.option_groups import with_option_groups
from mbtool.cli.options import AllowOption, condition
from mbtool.cli.talk import say
from mbtool.core import UsageError, parse_link
from mbtool.core.link_spec import ANSWERED
from mbtool.core.numbers import parse_unit

if TYPE_CHECKING:
    from mbtool.cli.output import RecordOutput
    from mbtool.workflows.shared.slave_monitor import SlaveMonitor

_WITH_UNIT = re.compile(r"(\d{1,3})=(.+)", re.ASCII | re.DOTALL)


@with_option_groups
def slave(
    profile: Annotated[
        str,
        typer.Argument(
            metavar="PROFILE",
            help="A built-in profile (see mbtool devices), or the path of a TOML file.",
        ),
    ],
    *,
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
    strict_timing: Annotated[
        bool,
        typer.Option(
            "--strict-timing",
            help="On an RTU line, give no answer to a request with a silence of t3.5 inside, or "
            "with less than t3.5 before or after it.",
        ),
    ] = False,
    allow: AllowOption = None,
    connections: ConnectionOptions,
) -> None:
    """Answer as a device does, or several, until Ctrl-C.

    It has the areas, limits and exceptions of the device's manual, keeps what is written to it, and
    does what docs/slave.md says.
    """
    from mbtool.cli.output import open_output
    from mbtool.cli.serve import serve, while_read
    from mbtool.devices import load_profile
    from mbtool.ports.tcp_listener import AllowedPeers
    from mbtool.workflows.shared.slave_monitor import SlaveMonitor
    from mbtool.workflows.slave import Station, device_slave

    if len(on) > 1:
        raise UsageError(
            f"--on {on[1]}: a slave has one link, here {on[0]}; start another slave for it"
        )
    link = parse_link(on[0], ANSWERED)
    device = load_profile(profile)
    own, names = _units(unit or ())
    images = _images(image or (), own, names)
    others = {
        number: Station(load_profile(name), images.get(number)) for number, name in names.items()
    }
    monitor = None
    if print_:
        monitor = SlaveMonitor(device, link, {n: one.profile for n, one in others.items()})
    shell = device_slave(
        device,
        link,
        own,
        images.get(own),
        others=others,
        state_file=state,
        fault_file=fault,
        allowed=AllowedPeers.parse(allow or (), connections.read()),
        monitor=monitor,
        strict_timing=strict_timing,
        on_trouble=lambda text: say(f"mbtool: {text}"),
    )
    devices = {own: device} | {number: one.profile for number, one in others.items()}
    who = ", ".join(f"{one.title} as unit {number}" for number, one in devices.items())
    if monitor is None:
        serve(shell, who)
        return
    with open_output(None, None, None, monitor.profile_for, condition(None)) as out:
        show = while_read(lambda: _show(monitor, out))

        def look() -> None:
            show()
            _say_changes(monitor)

        serve(shell, who, look)


def _show(monitor: SlaveMonitor, out: RecordOutput) -> None:
    """Print the requests and responses since the last call."""
    for record in monitor.records():
        out.add(record)
    out.wait()


def _say_changes(monitor: SlaveMonitor) -> None:
    """Say which outputs changed since the last call, and how many requests were not shown."""
    if missed := monitor.missed():
        say(f"mbtool: {missed:,} requests not shown: they come faster than they can be printed")
    if changed := monitor.changed_outputs():
        say("outputs: " + ", ".join(f"{one.name} {one.text}" for one in changed))


def _units(texts: Sequence[str]) -> tuple[int, dict[int, str]]:
    """Return the unit of the first device, and the profile names of the other devices by unit.

    `texts` are the values of --unit: `5` is the first device's unit (1 if none is given), `6=NAME`
    is another device. Raises UsageError for a text that is no unit, and if two devices have the
    same unit.
    """
    own: int | None = None
    others: dict[int, str] = {}
    for text in texts:
        with_profile = _WITH_UNIT.fullmatch(text)
        digits = with_profile[1] if with_profile is not None else text
        unit = parse_unit(digits, "--unit", ", or 3=PROFILE for another device")
        if with_profile is not None:
            if unit in others:
                raise UsageError(f"--unit {text}: unit {unit} has a profile already; name one")
            others[unit] = with_profile[2]
        elif own is not None:
            raise UsageError(
                f"--unit {text}: the device is unit {own} already; "
                f"write {text}=PROFILE for another one beside it"
            )
        else:
            own = unit
    own = 1 if own is None else own
    if own in others:
        raise UsageError(
            f"--unit {own}={others[own]}: unit {own} is the first device; choose another unit, "
            "or give the first device another one with --unit N"
        )
    return own, others


def _images(texts: Sequence[str], own: int, others: dict[int, str]) -> dict[int, Path]:
    """Return the files of start values by the unit of their device.

    `texts` are the values of --image: `FILE` for the first device, whose unit is `own`, or
    `6=FILE`. `others` has the other devices by unit. Raises UsageError for a unit without a device,
    and for a unit with two files.
    """
    images: dict[int, Path] = {}
    for text in texts:
        with_unit = _WITH_UNIT.fullmatch(text)
        unit = own if with_unit is None else int(with_unit[1])
        if unit != own and unit not in others:
            raise UsageError(f"--image {text}: no device is unit {unit}; see --unit")
        if unit in images:
            raise UsageError(f"--image {text}: unit {unit} has a file already; join the two")
        images[unit] = Path(text if with_unit is None else with_unit[2])
    return images
