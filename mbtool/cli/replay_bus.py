"""mbtool replay --as-bus: send every byte of master and slaves to a serial line."""

from __future__ import annotations

import typer

from mbtool.cli import exit_codes
from mbtool.cli.keys import controlled
from mbtool.cli.progress import with_progress
from mbtool.cli.talk import say
from mbtool.core import LinkSpec, SerialLink
from mbtool.core.moments import milliseconds
from mbtool.sources.child import run_promptly
from mbtool.workflows.replay_bus import BusOptions, BusReport, BusRun, line_link


def play_as_bus(file: str, on: LinkSpec, options: BusOptions) -> None:
    """Send the recording, and print how late bytes were sent."""
    link = line_link(on)
    run = BusRun(file, options, link, say, with_progress)
    told = _what_is_played(file, run, link, options)
    if options.rate is not None:
        run_promptly()
    with controlled() as (keys, stops):
        report = run.play(stops=stops, on_open=lambda: say(told), controls=keys)
        was_stopped = stops()
    say(_outcome(report))
    if was_stopped:
        raise typer.Exit(exit_codes.INTERRUPTED)


def _what_is_played(file: str, run: BusRun, link: SerialLink, options: BusOptions) -> str:
    size = sum(len(piece.data) for piece in run.pieces)
    lasts = "as fast as the line carries them"
    if options.rate is not None:
        lasts = f"{float(run.length_ns / options.rate) / 1e9:,.1f} s"
    again = ", again and again" if options.is_loop else ""
    return f"{file}: {size:,} bytes on {link}, {lasts}{again}; Ctrl-C ends"


def _outcome(report: BusReport) -> str:
    text = f"{report.bytes:,} bytes in {report.pieces:,} pieces"
    if report.lateness_p99_ns is not None:
        text = f"{text}; at most {milliseconds(report.lateness_p99_ns)} late (p99)"
    if report.held:
        text = f"{text}; {report.held:,} waited for the line, which is too slow for their times"
    return text
