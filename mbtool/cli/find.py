"""mbtool find: tell which registers hold the number that a display shows."""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from mbtool.cli import exit_codes
from mbtool.cli.listening import allowed_networks, chosen_tcp_ports, sniffer_of
from mbtool.cli.option_groups import with_option_groups
from mbtool.cli.options import RawOption, SilenceOptions, SourceOptions
from mbtool.cli.progress import with_progress
from mbtool.cli.talk import say, say_if_interrupted
from mbtool.core import InputError, UsageError, parse_link
from mbtool.core.link_spec import HEARD

if TYPE_CHECKING:
    from mbtool.devices import Who
    from mbtool.values.sightings import Seen

_MOST_PLACES = 5


@with_option_groups
def find(
    arguments: Annotated[
        list[str],
        typer.Argument(
            metavar="FILE|LINK VALUE",
            help="Captures and logs, as for decode, or links, as for sniff; then what the display "
            "showed: 23.4, 23.4@10:15:03 (UTC, or a time since the beginning: @90s), "
            "Voltage=236.8V, 23.4+-0.2. Of a link, it is asked for.",
        ),
    ],
    *,
    unit: Annotated[
        str | None,
        typer.Option(
            "--unit",
            metavar="WHO",
            help="Look at this slave only: a unit (5), an address (192.168.3.250) or both "
            "(192.168.3.250/5).",
        ),
    ] = None,
    values: Annotated[
        str | None,
        typer.Option(
            "--values",
            metavar="FILE.csv",
            help="Take numbers from a file: in each row a time, and a number for each display.",
        ),
    ] = None,
    changed_between: Annotated[
        tuple[str, str] | None,
        typer.Option(
            "--changed-between",
            metavar="T1 T2",
            help="Find the setting that somebody changed between two times.",
        ),
    ] = None,
    keep: Annotated[
        str | None,
        typer.Option(
            "--keep",
            metavar="FILE.toml",
            help="Write the most likely places as points of a profile: a new one, drafted from "
            "the recording, or one that is there.",
        ),
    ] = None,
    top: Annotated[
        int, typer.Option("--top", metavar="N", min=1, max=100, help="Show so many places.")
    ] = _MOST_PLACES,
    as_json: Annotated[bool, typer.Option("--json", help="Print all places as JSON.")] = False,
    raw: RawOption = False,
    source: SourceOptions,
    silences: SilenceOptions,
) -> None:
    """Tell which registers hold the number that a display shows.

    All types, orders and decimal scales are tried. Exit code 1 means that a number is in no
    register with a likelihood of 50 % or more.
    """
    from mbtool.cli.stats import is_link
    from mbtool.devices import parse_who
    from mbtool.values.sightings import parse_seen, parse_table

    sources, texts = _sources_and_numbers(arguments)
    who = parse_who(unit) if unit is not None else None
    seen = [parse_seen(text) for text in texts]
    if values is not None:
        seen += parse_table(_read_text(values), values)
    if changed_between is not None and (seen or keep is not None):
        raise UsageError("--changed-between goes without numbers and without --keep")
    if any(is_link(one) for one in sources):
        if seen or changed_between is not None or as_json or raw:
            raise UsageError("of a LINK, numbers are asked for; name a recording to give them here")
        find_live(sources, who, source, silences, top, keep)
        return
    if not seen and changed_between is None:
        raise UsageError("name what the display showed behind the files: 23.4, or 23.4@10:15:03")
    _find_in_files(
        sources, seen, changed_between, who, source, silences, top, keep,
        as_json=as_json, raw=raw,
    )  # fmt: skip


def _sources_and_numbers(arguments: Sequence[str]) -> tuple[list[str], list[str]]:
    """Divide the arguments into files or links, and numbers.

    The first one is a file or link; the numbers begin with the first of the others that is no file
    or link.
    """
    from mbtool.cli.stats import is_link

    at = next(
        (
            at
            for at, one in enumerate(arguments)
            if at and not os.path.exists(one) and not is_link(one)
        ),
        len(arguments),
    )
    return list(arguments[:at]), list(arguments[at:])


def _read_text(path: str) -> str:
    try:
        return Path(path).read_text(encoding="utf-8-sig", errors="replace")
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror or error}") from error


def _find_in_files(
    files: Sequence[str],
    seen: Sequence[Seen],
    changed_between: tuple[str, str] | None,
    who: Who | None,
    source: SourceOptions,
    silences: SilenceOptions,
    top: int,
    keep: str | None,
    *,
    as_json: bool,
    raw: bool,
) -> None:
    import json

    from mbtool.cli.found_output import keep_places, print_changes, print_places
    from mbtool.cli.output import say_if_empty
    from mbtool.values.finding import LIKELY
    from mbtool.values.sightings import parse_time
    from mbtool.views.found_places import changed_document, found_document
    from mbtool.workflows.find import FindRun

    between = [parse_time(text) for text in changed_between or ()]
    run = FindRun(files, source.read(raw=raw, silences=silences), who)
    run.reading.demand_files()
    with say_if_interrupted():
        run.read([one.time for one in seen if one.time is not None], with_progress)
    for remark in run.reading.remarks:
        say(remark)
    say_if_empty(run.reading)
    finder = run.finder
    is_found = False
    if finder.first_ns and changed_between is not None:
        begin_ns, end_ns = (one.at_ns(finder.first_ns) for one in between)
        if end_ns <= begin_ns:
            raise UsageError("--changed-between: the second time is not after the first")
        for at_ns, text in zip((begin_ns, end_ns), changed_between, strict=True):
            run.demand_inside(at_ns, f"--changed-between {text}:")
        changes = finder.changed(begin_ns, end_ns)
        is_found = bool(changes)
        if as_json:
            typer.echo(json.dumps(changed_document(changes), indent=2))
        else:
            print_changes(finder, changes[:top])
    elif finder.first_ns:
        wanted = run.wanted(seen)
        found = finder.places(wanted)
        is_found = all(places and places[0].likelihood >= LIKELY for places in found)
        if as_json:
            typer.echo(json.dumps(found_document(wanted, found), indent=2))
        else:
            print_places(finder, wanted, found, top)
        if keep is not None:
            keep_places(finder, wanted, found, keep, os.path.basename(files[0]))
    if run.error is not None:
        raise run.error
    if not is_found:
        raise typer.Exit(exit_codes.NO)


# The part of mbtool find that listens on a link and asks what the display shows.


def find_live(
    sources: Sequence[str],
    who: Who | None,
    ports: SourceOptions,
    silences: SilenceOptions,
    top: int,
    keep: str | None,
) -> None:
    """Listen on links; for each number that the user types, print the places so far.

    An empty line ends it. Raises LinkError if a link cannot be opened.
    """
    from mbtool.cli.found_output import keep_places, print_places
    from mbtool.decode.line_timing import LineTiming
    from mbtool.devices import Assignments
    from mbtool.values.finding import LIKELY
    from mbtool.values.sightings import parse_seen
    from mbtool.workflows.find import LiveFinder
    from mbtool.workflows.sniff import serial_lines, with_settings

    specs = [parse_link(link, HEARD) for link in sources]
    allowed, tcp_ports = allowed_networks(specs, None), chosen_tcp_ports(specs, ports)
    timing = LineTiming(Assignments(), *silences.read())
    serial_lines(specs)
    specs = timing.given(with_settings(specs, say))
    sniffer = sniffer_of(specs, timing, tcp_ports, allowed, reconnects=True)
    with ExitStack() as opened:
        opened.enter_context(sniffer)
        say(f"listening on {', '.join(sniffer.places)}")
        live = LiveFinder(sniffer, opened.pop_all(), who)
        live.start()
        try:
            say(
                "Type what the display shows, such as 23.4 or Voltage=236.8V, and again when it "
                "shows something else; an empty line ends."
            )
            for line in sys.stdin:
                if not line.strip():
                    break
                try:
                    live.see(parse_seen(line.strip()))
                except UsageError as error:
                    say(f"mbtool: {error}")
                    continue
                print_places(live.finder, live.wanted, live.places(), top)
                sys.stdout.flush()
        finally:
            live.stop()
    if live.error is not None:
        raise live.error
    if not live.wanted:
        return
    found = live.places()
    if keep is not None:
        keep_places(live.finder, live.wanted, found, keep, ", ".join(sources))
    if not all(places and places[0].likelihood >= LIKELY for places in found):
        raise typer.Exit(exit_codes.NO)
