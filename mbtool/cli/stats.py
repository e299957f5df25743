"""mbtool stats: show what is polled, how fast, what fails, and how a line's time is spent."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from math import inf
from typing import TYPE_CHECKING, Annotated

import typer

from mbtool.cli.listening import (
    allowed_networks,
    chosen_tcp_ports,
    found_settings,
    sniffer_of,
)
from mbtool.cli.option_groups import with_option_groups
from mbtool.cli.options import (
    AllowOption,
    CaptureOptions,
    WhereOption,
    condition,
)
from mbtool.cli.progress import with_progress
from mbtool.cli.talk import (
    Interrupt,
    Interrupted,
    interruptible,
    say,
    say_if_interrupted,
)
from mbtool.core import InputError, SerialFormat, UsageError, parse_link
from mbtool.core.link_spec import HEARD
from mbtool.workflows.shared.named_files import named_files

if TYPE_CHECKING:
    from rich.console import Console
    from rich.text import Text

    from mbtool.devices import Profile
    from mbtool.ledger.account import Account
    from mbtool.troubles.judge import Judgement
    from mbtool.workflows.shared.reading import ReadingOptions
    from mbtool.workflows.stats import LiveStatistics

_LINK_KINDS = ("rtu:", "ascii:", "net:", "tap:", "rtutap:", "tcp:", "rtu+tcp:")
"""The beginnings of a LINK. stats cannot listen on tcp: and rtu+tcp:. They are listed so that the
error message names a link that cannot be heard, and not a file that does not exist."""
REFRESH_NS = 1_000_000_000
"""The least time between two refreshes of the figures of a live link, in ns."""
REFRESH_SHARE = 10
"""The pause between two refreshes is at least this many times as long as a refresh takes, so that
decoding comes first."""


@with_option_groups
def stats(
    sources: Annotated[
        list[str],
        typer.Argument(
            metavar="FILE|LINK",
            help="Captures and logs, as for decode; or links to listen on, as for sniff.",
        ),
    ],
    *,
    capture: CaptureOptions,
    where: WhereOption = None,
    top: Annotated[
        int | None,
        typer.Option(
            "--top",
            metavar="N",
            min=1,
            help="List at most so many rows of each kind. [default: as many as fit the terminal, "
            "3 to 10; else 10]",
        ),
    ] = None,
    as_json: Annotated[
        bool, typer.Option("--json", help="Print one JSON document (docs/stats.md) at the end.")
    ] = False,
    advice: Annotated[
        bool,
        typer.Option(
            "--advice",
            help="Say which requests of a polled list could be one, and how long its cycle would "
            "be then; nothing else.",
        ),
    ] = False,
    duration: Annotated[
        float | None,
        typer.Option("--duration", metavar="S", min=0, help="Listen for so many seconds."),
    ] = None,
    allow: AllowOption = None,
) -> None:
    """Show what is polled, how fast and what fails; of links live.

    It also shows what a serial line's time goes into, and the master's poll cycle. Of a link, the
    figures come anew each second until Ctrl-C; nothing is logged, as sniff -w does that.
    docs/stats.md explains each figure.
    """
    from mbtool.cli.output import demand_standard_output

    demand_standard_output()
    live = [is_link(one) for one in sources]
    if any(live) and not all(live):
        raise UsageError("name files or links, not both")
    if any(live) and (capture.raw or capture.source.link is not None):
        raise UsageError("--raw and --link go with files")
    if not any(live) and (duration is not None or allow):
        raise UsageError("--duration and --allow go with a link")
    if not any(live):
        sources = named_files(sources)
    if advice and any(live):
        raise UsageError("--advice goes with files")
    shown = _Shown(sources, where, as_json, top, advice)
    if any(live):
        _listen(shown, capture, allow, duration)
    else:
        _read(shown, capture.read())


def is_link(text: str) -> bool:
    """True if the text is a link. A file is not a link, even if its name begins like one."""
    return text.startswith(_LINK_KINDS) and not os.path.exists(text)


@dataclass(frozen=True, slots=True)
class _Shown:
    """The files or links, and the options for showing their statistics."""

    sources: Sequence[str]
    where: str | None
    as_json: bool
    top: int | None
    is_advice: bool

    def print(
        self,
        account: Account,
        judgement: Judgement,
        remarks: Sequence[str] = (),
        *,
        is_whole: bool = True,
        profile_named: Callable[[str], Profile | None] = lambda _: None,
    ) -> None:
        """Print the statistics to standard output. Raises OutputError if it cannot be written.

        `remarks` are lines about the files. `is_whole` is False if a part of them was not read.
        `profile_named` returns the profile of this name, if it is in use.
        """
        from mbtool.cli.console import PipeConsole
        from mbtool.cli.output import as_output_error
        from mbtool.sources.files import shown_name
        from mbtool.views.statistics_document import statistics_document

        if self.is_advice:
            _print_advice(account, judgement, profile_named, as_json=self.as_json)
            return
        with as_output_error("standard output"):
            if self.as_json:
                text = statistics_document(
                    account,
                    judgement,
                    sources=[*map(shown_name, self.sources)],
                    where=self.where,
                    remarks=remarks,
                    is_whole=is_whole,
                )
                sys.stdout.write(text)
            elif account.transactions or any(one.connections for one in judgement.links):
                console = PipeConsole(file=sys.stdout)
                for line in self.lines(judgement, console):
                    console.print(line, soft_wrap=True)
            sys.stdout.flush()

    def lines(self, judgement: Judgement, console: Console) -> list[Text]:
        """Return the lines of the table; on a terminal, they are fitted to its width and height."""
        from rich.text import Text

        from mbtool.views.statistics_table import statistics_lines

        is_terminal = console.is_terminal
        lines = statistics_lines(
            judgement,
            width=console.width if is_terminal else None,
            height=console.height if is_terminal else None,
            top=self.top,
        )
        return [Text(line.text, line.style) for line in lines]


def _print_advice(
    account: Account,
    judgement: Judgement,
    profile_named: Callable[[str], Profile | None],
    *,
    as_json: bool,
) -> None:
    """Print which requests could be one."""
    import json

    from mbtool.ledger.advice import advice_of
    from mbtool.views.advice_lines import advice_document, advice_lines
    from mbtool.views.tables import printable

    found = advice_of(judgement.links, lambda name: account.links[name].format, profile_named)
    if as_json:
        typer.echo(json.dumps(advice_document(found), indent=2))
    elif found:
        typer.echo("\n".join(map(printable, advice_lines(found))))
    else:
        typer.echo("no two requests of a polled list can be one")


def _read(shown: _Shown, options: ReadingOptions) -> None:
    """Compute the statistics of files, and print them."""
    from mbtool.cli.output import say_if_empty
    from mbtool.workflows.check import CheckRun

    wanted = None if shown.where is None else condition(shown.where)
    run = CheckRun(shown.sources, options, wanted=wanted)
    reading = run.reading
    reading.demand_files()
    broken: InputError | None = None
    with say_if_interrupted(), interruptible() as interrupt:
        try:
            for _ in interrupt.breakable(run.findings(with_progress)):
                pass
            reading.demand_readable()
        except InputError as error:
            broken = error
        why = reading.why_empty if broken is None else str(broken)
        remarks = [*run.remarks, *([] if why is None else [why])]
        shown.print(
            run.ledger,
            run.judgement(),
            remarks,
            is_whole=broken is None,
            profile_named=reading.profile_named,
        )
    for remark in run.remarks:
        say(remark)
    if broken is not None:
        raise broken
    say_if_empty(reading)
    if not run.ledger.transactions and reading.why_empty is None:
        say(_none(shown))


def _none(shown: _Shown) -> str:
    return "no transactions" if shown.where is None else "no transactions pass --where"


def _listen(
    shown: _Shown,
    capture: CaptureOptions,
    allow: list[str] | None,
    duration_s: float | None,
) -> None:
    """Compute the statistics of links, and print them at the end.

    On a terminal they are shown each second until then. `allow` are the values of --allow.
    Listening ends with Ctrl-C, or after `duration_s` seconds if not None.
    """
    from mbtool.workflows.sniff import serial_lines
    from mbtool.workflows.stats import LiveStatistics

    wanted = None if shown.where is None else condition(shown.where)
    specs = [parse_link(link, HEARD) for link in shown.sources]
    allowed, tcp_ports = allowed_networks(specs, allow), chosen_tcp_ports(specs, capture.source)
    timing = capture.timing()
    serial_lines(specs)
    specs = timing.given(found_settings(specs, None))
    lines = serial_lines(specs)

    def format_of(link: str) -> SerialFormat | None:
        return timing.format_of(lines[link]) if link in lines else None

    live = LiveStatistics(format_of, wanted, timing.assignments)
    with interruptible() as interrupt, sniffer_of(specs, timing, tcp_ports, allowed) as sniffer:
        say(f"listening on {', '.join(sniffer.places)}; Ctrl-C ends")
        with _view(shown, live) as refresh:
            ends = _end(interrupt, duration_s, live, refresh)
            for record in sniffer.records(ends, lambda: interrupt.asked):
                live.add(record)
    live.close()
    shown.print(live.account, live.judgement())
    if not live.account.transactions:
        say(_none(shown))
    if interrupt.asked:
        raise Interrupted


def _end(
    interrupt: Interrupt,
    duration_s: float | None,
    live: LiveStatistics,
    refresh: Callable[[], None],
) -> Callable[[int], bool]:
    """Return a function that takes the time in ns since 1970 and returns True if stats must end.

    It must end after Ctrl-C or `duration_s` seconds (None: no limit). When a refresh is due, the
    function brings `live` up to this time and calls `refresh`.
    """
    from mbtool.ports.clock import now_ns

    end_ns = inf if duration_s is None else now_ns() + duration_s * 1e9
    shown_ns, pause_ns = 0, REFRESH_NS

    def ends(at_ns: int) -> bool:
        nonlocal shown_ns, pause_ns
        if not 0 <= at_ns - shown_ns < pause_ns:
            live.advance(at_ns)
            refresh()
            shown_ns = now_ns()
            pause_ns = max(REFRESH_NS, REFRESH_SHARE * (shown_ns - at_ns))
        return interrupt.asked or at_ns >= end_ns

    return ends


@contextmanager
def _view(shown: _Shown, live: LiveStatistics) -> Iterator[Callable[[], None]]:
    """Show live figures on the terminal while the context is open; yield a function to redraw them.

    With --json or without a terminal, nothing is shown and the function does nothing.
    """
    from mbtool.cli.console import PipeConsole

    console = PipeConsole(file=sys.stdout)
    if shown.as_json or not console.is_terminal:
        yield lambda: None
        return
    from rich.live import Live
    from rich.text import Text

    with Live(console=console, auto_refresh=False, transient=True) as view:

        def refresh() -> None:
            lines = shown.lines(live.judgement(), console)[: console.height - 1]
            view.update(Text("\n").join(lines), refresh=True)

        yield refresh
