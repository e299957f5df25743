"""mbtool replay: play one side of a recording, or both."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from mbtool.cli.options import (
    AllowOption,
    DeviceOption,
    LineOption,
    PortOption,
    RawOption,
    RtuPortOption,
    WhereOption,
)

if TYPE_CHECKING:
    from fractions import Fraction


_MAX_S = 1e9


class MatchChoice(StrEnum):
    """The values of replay.Match, which would bring the protocol into every --help."""

    AUTO = "auto"
    SEQUENCE = "sequence"
    KEY = "key"
    TIME = "time"
    IMAGE = "image"


class MissChoice(StrEnum):
    """The values of replay.OnMiss, likewise."""

    IMAGE = "image"
    EXCEPTION = "exception"
    SILENT = "silent"


class EndChoice(StrEnum):
    """The values of replay.OnEnd, likewise."""

    LAST = "last"
    LOOP = "loop"
    IMAGE = "image"
    SILENT = "silent"


AS_SLAVE, AS_MASTER, AS_BUS = "--as-slave", "--as-master", "--as-bus"

_ONLY = {
    "match": AS_SLAVE,
    "on_miss": AS_SLAVE,
    "on_end": AS_SLAVE,
    "latency": AS_SLAVE,
    "faults_as_recorded": AS_SLAVE,
    "fault": AS_SLAVE,
    "allow": AS_SLAVE,
    "ignore": AS_MASTER,
    "ignore_from": AS_MASTER,
    "learn": AS_MASTER,
    "timeout": AS_MASTER,
    "latency_tolerance": AS_MASTER,
    "report": AS_MASTER,
}
"""Options that mean something on one side only."""


def replay(
    context: typer.Context,
    file: Annotated[
        str, typer.Argument(metavar="FILE", help="A log or a packet capture, as for decode.")
    ],
    as_slave: Annotated[
        bool, typer.Option(AS_SLAVE, help="Answer a live master as the recorded slaves did.")
    ] = False,
    as_master: Annotated[
        bool,
        typer.Option(
            AS_MASTER, help="Ask a live slave what was recorded, and compare its answers."
        ),
    ] = False,
    as_bus: Annotated[
        bool,
        typer.Option(
            AS_BUS, help="Send every byte of both sides, with its timing, to a serial line."
        ),
    ] = False,
    on: Annotated[
        str | None,
        typer.Option(
            "--on",
            metavar="LINK",
            help="Where to answer as the slave: rtu:PORT@19200-8E1, ascii:PORT@9600-7E1, "
            "tcp:HOST:PORT or rtu+tcp:HOST:PORT; as the bus: one of the first two.",
        ),
    ] = None,
    to: Annotated[
        str | None,
        typer.Option("--to", metavar="LINK", help="Where the slave is that is asked, likewise."),
    ] = None,
    match: Annotated[
        MatchChoice,
        typer.Option(
            "--match",
            help="As the slave: how the answer to a request is found. key: the next one to the "
            "same request; sequence: the recording's exact order; time: the one nearest to the "
            "recording's clock; image: from the registers as they were at that moment; auto: by "
            "key, else from the registers, else by the device's profile.",
        ),
    ] = MatchChoice.AUTO,
    on_miss: Annotated[
        MissChoice,
        typer.Option(
            "--on-miss",
            help="What a request gets that was never recorded: an answer from the registers as "
            "they were at that moment of the recording, an exception, or silence.",
        ),
    ] = MissChoice.IMAGE,
    on_end: Annotated[
        EndChoice | None,
        typer.Option(
            "--on-end",
            help="What a request gets when its recorded answers are over: the last one again, the "
            "first and so on, the registers as they were last, or silence. [default: last]",
        ),
    ] = None,
    latency: Annotated[
        str,
        typer.Option(
            "--latency",
            metavar="recorded|none|sampled|5ms",
            help="As the slave: how long answers take; sampled draws from the recorded ones.",
        ),
    ] = "recorded",
    faults_as_recorded: Annotated[
        bool,
        typer.Option(
            "--faults-as-recorded",
            help="As the slave: also answer with a wrong check or in part where that was so.",
        ),
    ] = False,
    fault: Annotated[
        Path | None,
        typer.Option(
            "--fault", metavar="FILE.toml", help="As the slave: spoil answers; docs/faults.md."
        ),
    ] = None,
    speed: Annotated[
        str,
        typer.Option(
            "--speed",
            metavar="FACTOR|max",
            help="How fast: recorded times and latencies are divided by this; max leaves them out.",
        ),
    ] = "1.0",
    loop: Annotated[
        bool, typer.Option("--loop", help="Again from the beginning, until Ctrl-C.")
    ] = False,
    start: Annotated[
        float,
        typer.Option("--start", metavar="S", help="Where to begin, in seconds of it."),
    ] = 0.0,
    end: Annotated[
        float | None,
        typer.Option("--end", metavar="S", help="Where to end, likewise."),
    ] = None,
    ignore: Annotated[
        list[str] | None,
        typer.Option(
            "--ignore",
            metavar="RANGE",
            help="As the master: registers whose values may differ, HR400010..400020 as the "
            "device's manual writes them, or 'holding 9..19'. Repeatable.",
        ),
    ] = None,
    ignore_from: Annotated[
        list[Path] | None,
        typer.Option(
            "--ignore-from", metavar="FILE", help="The same, from a file with a range in each line."
        ),
    ] = None,
    learn: Annotated[
        Path | None,
        typer.Option(
            "--learn",
            metavar="FILE",
            help="As the master: take registers that differ for ones that may, and add them to "
            "FILE for --ignore-from.",
        ),
    ] = None,
    timeout: Annotated[
        float,
        typer.Option(
            "--timeout",
            metavar="S",
            min=0.001,
            max=3600,
            help="As the master: how long to wait for an answer, in seconds.",
        ),
    ] = 1.0,
    latency_tolerance: Annotated[
        float | None,
        typer.Option(
            "--latency-tolerance",
            metavar="PERCENT",
            min=0,
            max=100_000,
            help="As the master: how much longer than recorded answers may take (median and 95th "
            "percentile). [default: any time]",
        ),
    ] = None,
    report: Annotated[
        Path | None,
        typer.Option(
            "--report",
            metavar="FILE",
            help="As the master: write what differs, .json or JUnit .xml.",
        ),
    ] = None,
    device: DeviceOption = None,
    where: WhereOption = None,
    raw: RawOption = False,
    port: PortOption = None,
    rtu_port: RtuPortOption = None,
    link: LineOption = None,
    allow: AllowOption = None,
) -> None:
    """Play one side of a recording, or both.

    As the slaves: a request gets its next recorded answer; when there is no further one, the last
    one again. Until Ctrl-C.

    As the master: recorded requests at recorded times; each answer is compared with the recorded
    one. Exit 1 when one differs.

    As the bus: every byte of both sides onto a serial line, for whoever listens there.

    At a terminal: space pauses, s or right steps, + and - or up and down change the speed, q ends.
    """
    from mbtool.cli.options import condition, reading_options
    from mbtool.core import parse_link
    from mbtool.core.link_spec import ANSWERED
    from mbtool.replay import MatchStrategy, OnEnd, OnMiss, TimeRange, Tolerance

    side = _side(as_slave=as_slave, as_master=as_master, as_bus=as_bus)
    link_text = _link_text(side, on, to)
    _demand_side(context, side)
    reading = reading_options(device=device, port=port, rtu_port=rtu_port, link=link, raw=raw)
    where_to = parse_link(link_text, ANSWERED)
    wanted, rate, window = condition(where), _rate(speed), TimeRange(*_window(start, end))
    if side == AS_SLAVE:
        from mbtool.cli.replay_slave import play_as_slave
        from mbtool.ports.allowed_peers import AllowedPeers
        from mbtool.workflows.replay_slave import SlaveOptions

        slave_options = SlaveOptions(
            reading=reading,
            wanted=wanted,
            match=MatchStrategy(match.value),
            on_miss=OnMiss(on_miss.value),
            on_end=OnEnd(_end(on_end, is_loop=loop).value),
            rate=rate,
            window=window,
            latency=latency,
            with_damage=faults_as_recorded,
            fault_file=fault,
        )
        play_as_slave(file, where_to, slave_options, AllowedPeers.parse(allow or ()))
        return
    if side == AS_BUS:
        from mbtool.cli.replay_bus import play_as_bus
        from mbtool.workflows.replay_bus import BusOptions

        bus_options = BusOptions(
            reading=reading, wanted=wanted, rate=rate, is_loop=loop, window=window
        )
        play_as_bus(file, where_to, bus_options)
        return
    from mbtool.cli.replay_master import play_as_master, ranges_of
    from mbtool.workflows.replay_master import MasterOptions

    tolerance = None if latency_tolerance is None else Tolerance(share=latency_tolerance / 100)
    master_options = MasterOptions(
        reading=reading,
        wanted=wanted,
        rate=rate,
        is_loop=loop,
        window=window,
        timeout_ns=round(timeout * 1e9),
        ignore=[*(ignore or ()), *ranges_of(ignore_from or ())],
        learns=learn is not None,
        tolerance=tolerance,
    )
    play_as_master(file, where_to, master_options, report, learn)


def _side(*, as_slave: bool, as_master: bool, as_bus: bool) -> str:
    from mbtool.core import UsageError

    chosen = {AS_SLAVE: as_slave, AS_MASTER: as_master, AS_BUS: as_bus}
    sides = [side for side, is_chosen in chosen.items() if is_chosen]
    if len(sides) != 1:
        raise UsageError(
            "say which side to play: --as-slave --on LINK, --as-master --to LINK, "
            "or --as-bus --on LINK"
        )
    return sides[0]


def _link_text(side: str, on: str | None, to: str | None) -> str:
    from mbtool.core import UsageError

    needed, text, other = ("--to", to, on) if side == AS_MASTER else ("--on", on, to)
    if text is None or other is not None:
        raise UsageError(f"{side} goes with {needed} LINK")
    return text


def _demand_side(context: typer.Context, side: str) -> None:
    """See that no option was given that would mean nothing. Raises UsageError."""
    from mbtool.core import UsageError

    for name, only in _ONLY.items():
        source = context.get_parameter_source(name)
        if only != side and source is not None and source.name == "COMMANDLINE":
            raise UsageError(f"--{name.replace('_', '-')} goes with {only}, not {side}")


def _end(on_end: EndChoice | None, *, is_loop: bool) -> EndChoice:
    from mbtool.core import UsageError

    if is_loop and on_end not in (None, EndChoice.LOOP):
        raise UsageError(f"--loop is --on-end loop; leave it out for --on-end {on_end}")
    return EndChoice.LOOP if is_loop else on_end or EndChoice.LAST


def _window(start: float, end: float | None) -> tuple[int, int | None]:
    from mbtool.core import UsageError

    for option, seconds in (("--start", start), ("--end", end)):
        if seconds is not None and not 0 <= seconds <= _MAX_S:  # So is nan.
            raise UsageError(f"{option} {seconds:g}: write seconds, such as 2.5")
    if end is not None and end <= start:
        raise UsageError(f"--end {end:g}: is not behind --start {start:g}")
    return round(start * 1e9), None if end is None else round(end * 1e9)


def _rate(text: str) -> Fraction | None:
    from fractions import Fraction

    from mbtool.core import UsageError

    if text == "max":
        return None
    try:
        rate = Fraction(text)
    except (ValueError, ZeroDivisionError):
        rate = Fraction(0)
    if rate <= 0 or len(text) > 20:
        raise UsageError(f"--speed {text!r}: write a factor more than 0, or max")
    return rate
