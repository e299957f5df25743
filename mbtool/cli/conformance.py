"""mbtool test: test a slave against its profile and the standard."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from mbtool.cli import exit_codes
from mbtool.cli.ask_options import ListenOption, TimeoutOption, listen_ns
from mbtool.cli.options import ListFormat
from mbtool.cli.output_file import demand_writable
from mbtool.cli.output_path import demand_new
from mbtool.cli.talk import interruptible, say
from mbtool.core import SerialLink, UsageError, parse_link
from mbtool.core.limits import RESPONSE_TIMEOUT_S
from mbtool.core.link_spec import ANSWERED
from mbtool.core.moments import counted
from mbtool.core.numbers import parse_unit

if TYPE_CHECKING:
    from mbtool.workflows.conformance import CaseResult, TestReport

_MOST_SHOWN = 32
"""The table shows at most this many bytes of what was sent and heard."""


def test(
    profile: Annotated[
        str,
        typer.Argument(
            metavar="PROFILE",
            help="What the slave should do: a built-in profile (see mbtool devices) or the path of "
            "a TOML file.",
        ),
    ],
    link: Annotated[
        str,
        typer.Argument(
            metavar="LINK",
            help="Where it is: rtu:PORT@19200-8E1, ascii:PORT@9600-7E1, tcp:HOST:PORT or "
            "rtu+tcp:HOST:PORT.",
        ),
    ],
    *,
    unit: Annotated[str, typer.Option("--unit", metavar="UNIT", help="Its unit.")] = "1",
    writes: Annotated[
        list[str] | None,
        typer.Option(
            "--writes",
            metavar="RANGE",
            help="Addresses that may be written; each value is put back. Repeatable.",
        ),
    ] = None,
    broadcast: Annotated[
        bool,
        typer.Option(
            "--broadcast",
            help="On a serial line: also write the addresses of --writes as a broadcast, to all "
            "slaves of the line.",
        ),
    ] = False,
    timeout: TimeoutOption = RESPONSE_TIMEOUT_S,
    repeat: Annotated[
        int, typer.Option("--repeat", metavar="N", min=1, help="Run all cases so often.")
    ] = 1,
    seed: Annotated[
        int, typer.Option("--seed", metavar="N", help="Chooses the random reads and bytes.")
    ] = 0,
    listen: ListenOption = None,
    report: Annotated[
        Path | None,
        typer.Option("--report", metavar="FILE.xml", help="Write the results as JUnit XML."),
    ] = None,
    overwrite: Annotated[
        bool, typer.Option("--overwrite", help="Replace the file of --report if there is one.")
    ] = False,
    format_: Annotated[ListFormat, typer.Option("--format", help="How to print.")] = "table",
) -> None:
    """Test a slave against its profile and the standard.

    Reads each area, its ends and limits, and sends what must be refused or ignored: unknown
    functions, wrong checks, torn frames, wrong headers. Writes nothing without --writes. Exit 1 if
    a case fails.
    """
    from mbtool.devices import load_profile, parse_span
    from mbtool.master.wire import open_wire
    from mbtool.workflows.ask import transport_of
    from mbtool.workflows.conformance import Conformance, Result, TestReport

    spec = parse_link(link, ANSWERED)
    number = parse_unit(unit, "--unit")
    known = load_profile(profile).with_limits_of(transport_of(spec))
    spans = [parse_span(text, [known]) for text in writes or ()]
    for text, span in zip(writes or (), spans, strict=True):
        if not span.table.is_writable:
            raise UsageError(f"--writes {text}: can only be read")
    if broadcast and not (spans and isinstance(spec, SerialLink)):
        raise UsageError("--broadcast needs a serial line, and --writes")
    if report is not None and report.suffix != ".xml":
        raise UsageError(f"--report {report}: let its name end in .xml")
    demand_new(None if report is None else str(report), overwrite=overwrite)
    if report is not None:
        demand_writable(report)
    whole = TestReport()
    heard_ns = listen_ns(listen)
    with interruptible() as interrupt, open_wire(spec, round(timeout * 1e9), heard_ns) as wire:
        say(f"testing unit {number} at {spec} against {known.name}; Ctrl-C ends")
        for turn in range(repeat):
            work = Conformance(known, spec, wire, number, seed + turn, broadcasts=broadcast)
            for _ in work.run(spans, lambda: interrupt.asked):
                pass
            whole.cases += work.report.cases
            if interrupt.asked:
                break
    _print(whole.cases, format_)
    if report is not None:
        _write(report, f"{known.name} at {spec}", whole)
    passed, failed = whole.count(Result.PASSED), whole.count(Result.FAILED)
    notes = whole.count(Result.NOTE)
    text = f"{counted(len(whole.cases), 'case')}: {passed} as expected, {failed} failed"
    say(f"{text}, {counted(notes, 'note')}")
    if interrupt.asked:
        turns = f" in run {turn + 1} of {repeat}" if repeat > 1 else ""
        say(f"interrupted{turns}; the cases after that were not run")
        raise typer.Exit(exit_codes.INTERRUPTED)
    if failed:
        raise typer.Exit(exit_codes.NO)


def _print(cases: Sequence[CaseResult], format_: ListFormat) -> None:
    """Print the cases that did not pass as a table, or all as JSON lines."""
    from mbtool.workflows.conformance import Result

    if format_ == "jsonl":
        import msgspec

        for one in cases:
            row = one._asdict() | {"sent": one.sent.hex(), "heard": one.heard.hex()}
            typer.echo(msgspec.json.encode(row).decode())
        return
    from mbtool.cli.console import PipeConsole
    from mbtool.views.tables import plain

    console = PipeConsole()
    styles = {Result.FAILED: ("failed", "red"), Result.NOTE: ("note", "yellow")}
    for one in cases:
        if one.result in styles:
            word, style = styles[one.result]
            for line, line_style in (
                (f"{word}  {one.name} ({one.section})", style),
                (f"    {one.problem}", ""),
                (f"    sent   {_bytes(one.sent)}", ""),
                (f"    heard  {_bytes(one.heard)}", ""),
            ):
                console.print(plain(line, line_style), soft_wrap=True)


def _bytes(raw: bytes) -> str:
    more = "" if len(raw) <= _MOST_SHOWN else f" ... {len(raw)} bytes"
    return f"{raw[:_MOST_SHOWN].hex(' ')}{more}" or "nothing"


def _write(file: Path, suite: str, report: TestReport) -> None:
    from mbtool.cli.output import as_output_error
    from mbtool.views.junit import Case, junit_xml
    from mbtool.workflows.conformance import Result

    cases = [
        Case(
            group=one.section,
            name=one.name,
            failures=[f"{one.problem}\nsent   {one.sent.hex(' ')}\nheard  {one.heard.hex(' ')}"]
            if one.result is Result.FAILED
            else (),
            time_ns=one.latency_ns,
        )
        for one in report.cases
    ]
    with as_output_error(str(file)):
        file.write_text(junit_xml(suite, cases), encoding="utf-8")
