"""The options of `mbtool replay`: those for slave, master or bus only, and those for all."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal

import typer

from mbtool.cli.ask_options import ListenOption, TimeoutOption, listen_ns
from mbtool.cli.option_groups import OptionGroup
from mbtool.core import UsageError
from mbtool.core.limits import RESPONSE_TIMEOUT_S
from mbtool.core.moments import parse_duration
from mbtool.core.numbers import parse_unit

if TYPE_CHECKING:
    from mbtool.devices import NamedTransaction
    from mbtool.replay import TimeRange
    from mbtool.workflows.replay_bus import BusOptions
    from mbtool.workflows.replay_master import MasterOptions
    from mbtool.workflows.replay_slave import SlaveOptions
    from mbtool.workflows.shared.reading import ReadingOptions

AS_SLAVE, AS_MASTER, AS_BUS = "--as-slave", "--as-master", "--as-bus"

_MAX_NS = 36_500 * 86_400 * 10**9
"""The largest --start and --end: a hundred years."""
_MAX_SPEED = 1000
"""The greatest factor of --speed; the least is 1 / 1000."""
_MAX_SPEED_CHARACTERS = 20
"""The most characters of --speed. It becomes an exact fraction, which is slow with more digits."""


# The values of MatchStrategy, OnMiss and OnEnd in replay/. They are repeated here because importing
# replay/ would make --help slow.
MatchChoice = Literal["auto", "sequence", "key", "time", "image"]
MissChoice = Literal["image", "exception", "silent"]
EndChoice = Literal["last", "loop", "image", "silent"]


@dataclass(frozen=True, slots=True)
class SideOptions(OptionGroup):
    """The options that choose the side to play (slaves, master or bus), and its links."""

    as_slave: Annotated[
        bool, typer.Option(AS_SLAVE, help="Answer a live master as the recorded slaves did.")
    ] = False
    as_master: Annotated[
        bool,
        typer.Option(
            AS_MASTER, help="Ask a live slave what was recorded, and compare its answers."
        ),
    ] = False
    as_bus: Annotated[
        bool,
        typer.Option(
            AS_BUS, help="Send every byte of both sides, with its timing, to a serial line."
        ),
    ] = False
    on: Annotated[
        list[str] | None,
        typer.Option(
            "--on",
            metavar="[WHO=]LINK",
            help="Where to answer as the slave: rtu:PORT@19200-8E1, ascii:PORT@9600-7E1, "
            "tcp:HOST:PORT or rtu+tcp:HOST:PORT; as the bus: one of the first two. As the slave "
            "also for each: 192.168.1.101=tcp:127.0.0.11:1502, all=tcp:127.0.0.0/24:1502.",
        ),
    ] = None
    to: Annotated[
        str | None,
        typer.Option("--to", metavar="LINK", help="Where the slave is that is asked, likewise."),
    ] = None

    def side_and_links(self) -> tuple[str, list[str]]:
        """Return the chosen side, such as `--as-slave`, and the texts of its links.

        Raises UsageError unless exactly one side is chosen with its own kind of link.
        """
        chosen = {AS_SLAVE: self.as_slave, AS_MASTER: self.as_master, AS_BUS: self.as_bus}
        sides = [side for side, is_chosen in chosen.items() if is_chosen]
        if len(sides) != 1:
            raise UsageError(
                "say which side to play: --as-slave --on LINK, --as-master --to LINK, "
                "or --as-bus --on LINK"
            )
        (side,) = sides
        on, to = self.on or [], [] if self.to is None else [self.to]
        links, others = (to, on) if side == AS_MASTER else (on, to)
        if not links or others:
            raise UsageError(f"{side} goes with {'--to' if side == AS_MASTER else '--on'} LINK")
        return side, links


@dataclass(frozen=True, slots=True)
class AsSlaveOptions(OptionGroup):
    """The options for --as-slave only."""

    heading: ClassVar[str] = "As the slave"

    match: Annotated[
        MatchChoice,
        typer.Option(
            "--match",
            help="As the slave: how the answer to a request is found. key: the next one to the "
            "same request; sequence: the recording's exact order; time: the one nearest to the "
            "recording's clock; image: from the registers as they were at that moment; auto: by "
            "key, else from the registers, else by the device's profile.",
        ),
    ] = "auto"
    on_miss: Annotated[
        MissChoice,
        typer.Option(
            "--on-miss",
            help="What a request gets that was never recorded: an answer from the registers as "
            "they were at that moment of the recording, an exception, or silence.",
        ),
    ] = "image"
    on_end: Annotated[
        EndChoice | None,
        typer.Option(
            "--on-end",
            help="What a request gets when its recorded answers are over: the last one again, the "
            "first and so on, the registers as they were last, or silence. [default: last]",
        ),
    ] = None
    latency: Annotated[
        str,
        typer.Option(
            "--latency",
            metavar="recorded|none|sampled|5ms",
            help="As the slave: how long answers take; sampled draws from the recorded ones.",
        ),
    ] = "recorded"
    faults_as_recorded: Annotated[
        bool,
        typer.Option(
            "--faults-as-recorded",
            help="As the slave: also answer with a wrong check or in part where that was so.",
        ),
    ] = False
    print_: Annotated[
        bool,
        typer.Option("--print", help="As the slave: show each request and its answer."),
    ] = False
    fault: Annotated[
        Path | None,
        typer.Option(
            "--fault", metavar="FILE.toml", help="As the slave: spoil answers; docs/faults.md."
        ),
    ] = None

    def read(self, shared: dict[str, Any], *, is_loop: bool) -> SlaveOptions:
        """Combine the options for --as-slave with those for every side.

        `shared` has the latter: the fields of PlayOptions by name. `is_loop` is True if --loop is
        given. Raises UsageError if --loop and --on-end contradict each other.
        """
        from mbtool.replay import MatchStrategy, OnEnd, OnMiss
        from mbtool.workflows.replay_slave import SlaveOptions

        return SlaveOptions(
            **shared,
            match=MatchStrategy(self.match),
            on_miss=OnMiss(self.on_miss),
            on_end=OnEnd(self._end(is_loop=is_loop)),
            latency=self.latency,
            with_damage=self.faults_as_recorded,
            fault_file=self.fault,
        )

    def _end(self, *, is_loop: bool) -> EndChoice:
        if is_loop and self.on_end not in (None, "loop"):
            raise UsageError(f"--loop is --on-end loop; leave it out for --on-end {self.on_end}")
        return "loop" if is_loop else self.on_end or "last"


@dataclass(frozen=True, slots=True)
class PaceOptions(OptionGroup):
    """The options for every side: the speed, the number of repetitions, and the part of the
    recording.
    """

    heading: ClassVar[str] = "Pace and part"

    speed: Annotated[
        str,
        typer.Option(
            "--speed",
            metavar="FACTOR|max",
            help="How fast: recorded times and latencies are divided by this; max leaves them out.",
        ),
    ] = "1.0"
    loop: Annotated[
        bool, typer.Option("--loop", help="Again from the beginning, until Ctrl-C.")
    ] = False
    answers_only: Annotated[
        bool,
        typer.Option(
            "--answers-only",
            help="Play requests and answers only: connections are neither opened, refused nor "
            "ended as recorded.",
        ),
    ] = False
    start: Annotated[
        str,
        typer.Option(
            "--start", metavar="TIME", help="Where to begin: 2.5 or 1h30m since the first request."
        ),
    ] = "0"
    end: Annotated[
        str | None, typer.Option("--end", metavar="TIME", help="Where to end, likewise.")
    ] = None

    def shared(
        self, reading: ReadingOptions, wanted: Callable[[NamedTransaction], bool]
    ) -> dict[str, Any]:
        """Return the options for every side as a dict: the fields of PlayOptions by name.

        Raises UsageError for a speed that is not a factor from 0.001 to 1000 or `max`, and for
        times that are out of range or order.
        """
        return {
            "reading": reading,
            "wanted": wanted,
            "rate": self._rate(),
            "window": self._window(),
            "answers_only": self.answers_only,
        }

    def as_bus(self, shared: dict[str, Any]) -> BusOptions:
        from mbtool.workflows.replay_bus import BusOptions

        return BusOptions(**shared, is_loop=self.loop)

    def _rate(self) -> Fraction | None:
        if self.speed == "max":
            return None
        try:
            rate = Fraction(self.speed if len(self.speed) <= _MAX_SPEED_CHARACTERS else "0")
        except (ValueError, ZeroDivisionError):
            rate = Fraction(0)
        if not Fraction(1, _MAX_SPEED) <= rate <= _MAX_SPEED:
            raise UsageError(
                f"--speed {self.speed!r}: write a factor from 0.001 to {_MAX_SPEED}, or max"
            )
        return rate

    def _window(self) -> TimeRange:
        from mbtool.replay import TimeRange

        start_ns = parse_duration(self.start, "--start", 0, _MAX_NS)
        end_ns = None if self.end is None else parse_duration(self.end, "--end", 0, _MAX_NS)
        if end_ns is not None and end_ns <= start_ns:
            raise UsageError(f"--end {self.end}: is not after --start {self.start}")
        return TimeRange(start_ns, end_ns)


@dataclass(frozen=True, slots=True)
class AsMasterOptions(OptionGroup):
    """The options for --as-master only."""

    heading: ClassVar[str] = "As the master"

    unit: Annotated[
        list[str] | None,
        typer.Option(
            "--unit",
            metavar="RECORDED=UNIT",
            help="As the master: ask another unit than the recorded one, as in 7=1. Repeatable.",
        ),
    ] = None
    tolerate: Annotated[
        list[str] | None,
        typer.Option(
            "--tolerate",
            metavar="NAME=AMOUNT",
            help="As the master: by how much a value may differ, in its unit: 'Temperature=0.5', "
            "float32=2%, HR400010..400019=1; Energy=counter may have grown. Repeatable.",
        ),
    ] = None
    ignore: Annotated[
        list[str] | None,
        typer.Option(
            "--ignore",
            metavar="RANGE",
            help="As the master: registers whose values may differ, HR400010..400020 as the "
            "device's manual writes them, or 'holding 9..19'. Repeatable.",
        ),
    ] = None
    ignore_from: Annotated[
        list[Path] | None,
        typer.Option(
            "--ignore-from", metavar="FILE", help="The same, from a file with a range in each line."
        ),
    ] = None
    learn: Annotated[
        Path | None,
        typer.Option(
            "--learn",
            metavar="FILE",
            help="As the master: take registers that differ for ones that may, and add them to "
            "FILE for --ignore-from.",
        ),
    ] = None
    timeout: TimeoutOption = RESPONSE_TIMEOUT_S
    listen: ListenOption = None
    latency_tolerance: Annotated[
        float | None,
        typer.Option(
            "--latency-tolerance",
            metavar="PERCENT",
            min=0,
            max=100_000,
            help="As the master: how much longer than recorded answers may take; more is found by "
            "the test that diff uses. [default: any time]",
        ),
    ] = None
    report: Annotated[
        Path | None,
        typer.Option(
            "--report",
            metavar="FILE",
            help="As the master: write what differs, .json or JUnit .xml. A "
            "file of that name is replaced.",
        ),
    ] = None

    def read(self, shared: dict[str, Any], *, is_loop: bool) -> MasterOptions:
        """Combine the options for --as-master with those for every side.

        `shared` has the latter: the fields of PlayOptions by name. `is_loop` is True if --loop is
        given. Raises InputError or UsageError if a file of register ranges cannot be read.
        """
        from mbtool.cli.range_lists import ranges_of
        from mbtool.replay import Tolerance
        from mbtool.workflows.replay_master import MasterOptions

        tolerance = None
        if self.latency_tolerance is not None:
            tolerance = Tolerance(share=self.latency_tolerance / 100)
        return MasterOptions(
            **shared,
            is_loop=is_loop,
            timeout_ns=round(self.timeout * 1e9),
            listen_ns=listen_ns(self.listen),
            ignore=[*(self.ignore or ()), *ranges_of(self.ignore_from or ())],
            learns=self.learn is not None,
            tolerance=tolerance,
            tolerate=self.tolerate or (),
            units=self._units(),
        )

    def _units(self) -> dict[int, int]:
        units = {}
        for text in self.unit or ():
            recorded, equals, asked = text.partition("=")
            if not equals:
                raise UsageError(f"--unit {text}: write RECORDED=UNIT, as in 7=1")
            units[parse_unit(recorded, "--unit")] = parse_unit(asked, "--unit")
        return units


_SIDE_OF_OPTION = {
    **dict.fromkeys([field.name for field in fields(AsSlaveOptions)], AS_SLAVE),
    "allow": AS_SLAVE,
    **dict.fromkeys([field.name for field in fields(AsMasterOptions)], AS_MASTER),
}
"""The only side (--as-slave or --as-master) that allows an option, by the option's parameter."""


def one_link(side: str, links: Sequence[str]) -> str:
    """Return the only link of --as-master or --as-bus, which take one.

    `side` is the option, for the message. Raises UsageError if there are several links.
    """
    if len(links) > 1:
        raise UsageError(f"--on {links[1]}: {side} has one link, here {links[0]}")
    return links[0]


def demand_side(context: typer.Context, side: str) -> None:
    """Raise UsageError if the user gave an option that is only for another side."""
    for name, only in _SIDE_OF_OPTION.items():
        source = context.get_parameter_source(name)
        if only != side and source is not None and source.name == "COMMANDLINE":
            raise UsageError(f"--{name.strip('_').replace('_', '-')} goes with {only}, not {side}")
