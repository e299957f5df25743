"""mbtool replay --as-master: send the recorded requests to a slave, and compare its responses."""

from __future__ import annotations

from typing import TYPE_CHECKING

import msgspec

from mbtool.cli import exit_codes
from mbtool.cli.console import PipeConsole
from mbtool.cli.keys import controlled
from mbtool.cli.output import as_output_error
from mbtool.cli.output_file import demand_writable
from mbtool.cli.output_path import demand_other_file
from mbtool.cli.progress import with_progress
from mbtool.cli.range_lists import add_ranges, demand_list
from mbtool.cli.talk import say
from mbtool.core import LinkError, LinkSpec, UsageError
from mbtool.core.moments import counted, milliseconds, plural
from mbtool.devices import DifferenceKind
from mbtool.replay.comparing import MIN_VALUES
from mbtool.sources.child import run_promptly
from mbtool.views.differences import print_differences
from mbtool.workflows.replay_master import MasterRun, interrupted_text, junit, request_text

if TYPE_CHECKING:
    from pathlib import Path

    from mbtool.cli.replay_options import AsMasterOptions
    from mbtool.workflows.replay_master import MasterOptions, Report

SIDES = ("recorded", "answered")
_NAMED = 3
"""The last line names at most this many requests whose answers came too late."""


def play_as_master(file: str, to: LinkSpec, options: MasterOptions, chosen: AsMasterOptions) -> int:
    """Send the requests of the recording `file` to the slave `to`, and compare its responses.

    Prints the responses that differ from the recorded ones, and returns the exit code: 1 if one
    does. The result is written to the file of --report, even if the slave cannot be reached; then
    LinkError is raised. The ranges of registers that differ are added to the file of --learn.
    """
    report_file, learn = chosen.report, chosen.learn
    if report_file is not None and report_file.suffix not in (".json", ".xml"):
        raise UsageError(f"--report {report_file}: name a .json file, or .xml for JUnit")
    lists = [str(each) for each in (*(chosen.ignore_from or ()), learn) if each is not None]
    for written, inputs in ((report_file, [file, *lists]), (learn, [file])):
        if written is not None:
            demand_other_file(inputs, str(written))
            demand_writable(written)
    run = MasterRun(file, options, say, with_progress)
    if learn is not None and learn.is_file():
        demand_list(learn, run)
    told = _what_is_played(file, run, to, options)
    if options.rate is not None or options.tolerance is not None:
        run_promptly()
    with controlled() as (keys, stops):
        report = run.play(to, stops=stops, on_open=lambda: say(told), controls=keys)
        was_stopped = stops()
    print_differences(PipeConsole(), report.differences, SIDES)
    if report.requests or report.problem is None:
        say(_outcome(report))
    if report_file is not None:
        is_json = report_file.suffix == ".json"
        document = msgspec.json.format(msgspec.json.encode(report), indent=2) if is_json else b""
        _write(report_file, document.decode() + "\n" if is_json else junit(report))
    if report.problem is not None:
        raise LinkError(report.problem)
    if learn is not None:
        add_ranges(learn, report.learned)
    if was_stopped:
        return exit_codes.INTERRUPTED
    return exit_codes.NO if report.differences else exit_codes.DONE


def _write(file: Path, text: str) -> None:
    with as_output_error(str(file)):
        file.write_text(text, encoding="utf-8")


def _what_is_played(file: str, run: MasterRun, to: LinkSpec, options: MasterOptions) -> str:
    requests = counted(len(run.script.steps), "request", ",")
    named = (
        f"{one} (as {options.units[one]})" if one in options.units else str(one)
        for one in sorted(run.script.units)
    )
    units = ", ".join(named) or "all"
    unit = plural(len(run.script.units), "unit")
    lasts = "as fast as answers come"
    if options.rate is not None:
        lasts = f"{float(run.script.length_ns / options.rate) / 1e9:,.1f} s"
    return f"{file}: {requests} to {unit} {units} on {to}, {lasts}; Ctrl-C ends"


def _outcome(report: Report) -> str:
    asked = counted(report.requests, "request", ",")
    if report.problem is None and (report.not_asked or report.not_awaited):
        asked = interrupted_text(report)
    elif report.not_asked:
        asked = f"{asked}, {report.not_asked:,} not asked"
    late = [one for one in report.differences if one.kind is DifferenceKind.LATENCY]
    failed = []
    if report.different or not (late or report.different_connections):
        failed.append(f"{counted(report.different, 'answer', ',')} not as recorded")
    if late:
        named = [f"unit {one.unit} {request_text(one.what, one.reference or '')}" for one in late]
        more = f" and {len(late) - _NAMED:,} more" if len(late) > _NAMED else ""
        failed.append(f"answers later than allowed to {', '.join(named[:_NAMED])}{more}")
    if report.different_connections:
        wrong = report.different_connections
        failed.append(
            f"{wrong:,} of {counted(report.connections, 'connection', ',')} not as recorded"
        )
    text = "; ".join((asked, *failed))
    if report.damaged:
        text += f"; {counted(report.damaged, 'answer', ',')} not compared, damaged in the recording"
    if report.unsolicited:
        text = f"{text}; {report.unsolicited:,} that nobody asked for"
    if report.uncompared_latencies:
        few = counted(report.uncompared_latencies, "request", ",")
        text = f"{text}; latencies of {few} not compared, as fewer than {MIN_VALUES} answers came"
    if report.lateness_p99_ns is not None:
        text = f"{text}; requests left at most {milliseconds(report.lateness_p99_ns)} late (p99)"
    return text
