"""The part of mbtool find that listens on a link and asks what the display shows."""

from __future__ import annotations

import sys
from contextlib import ExitStack
from typing import TYPE_CHECKING

import typer

if TYPE_CHECKING:
    from collections.abc import Sequence

    from mbtool.cli.options import SilenceOptions, SourceOptions
    from mbtool.devices import Who


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
    from mbtool.cli.listening import allowed_networks, heard_ports, sniffer_of
    from mbtool.cli.talk import say
    from mbtool.core import UsageError, parse_link
    from mbtool.core.link_spec import HEARD
    from mbtool.decode.line_timing import LineTiming
    from mbtool.devices import Assignments
    from mbtool.values.finding import LIKELY
    from mbtool.values.sightings import parse_seen
    from mbtool.workflows.find import LiveFinder
    from mbtool.workflows.sniff import serial_lines, with_settings

    specs = [parse_link(link, HEARD) for link in sources]
    allowed, tcp_ports = allowed_networks(specs, None), heard_ports(specs, ports)
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
        from mbtool.cli import exit_codes

        raise typer.Exit(exit_codes.NO)
