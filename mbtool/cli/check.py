"""mbtool check: find broken rules of Modbus and of device manuals in captures and logs."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator
from contextlib import contextmanager
from enum import StrEnum
from typing import TYPE_CHECKING, Annotated, TextIO

import typer

from mbtool.cli import exit_codes
from mbtool.cli.option_groups import with_option_groups
from mbtool.cli.options import (
    CaptureOptions,
    EndOption,
    OverwriteOption,
    StartOption,
)
from mbtool.cli.output_file import emptied, is_old
from mbtool.cli.output_path import chosen_format, demand_new, demand_other_file, named_file
from mbtool.cli.progress import with_progress
from mbtool.cli.talk import (
    NOTHING_WRITTEN,
    Interrupted,
    interruptible,
    say,
    say_if_interrupted,
)
from mbtool.core import InputError
from mbtool.core.moments import counted
from mbtool.version import __version__
from mbtool.workflows.shared.named_files import named_files
from mbtool.workflows.shared.time_window import TimeWindow

if TYPE_CHECKING:
    from rich.console import Console

    from mbtool.workflows.check import CheckRun, FileFinding


class CheckFormat(StrEnum):
    """The form in which findings are printed."""

    TABLE = "table"
    JSON = "json"
    SARIF = "sarif"
    JUNIT = "junit"


_SUFFIXES = {
    ".txt": CheckFormat.TABLE,
    ".json": CheckFormat.JSON,
    ".sarif": CheckFormat.SARIF,
    ".xml": CheckFormat.JUNIT,
}


@with_option_groups
def check(
    files: Annotated[
        list[str], typer.Argument(metavar="FILE", help="Captures and logs, as for decode.")
    ],
    *,
    capture: CaptureOptions,
    select: Annotated[
        list[str] | None,
        typer.Option(
            "--select",
            metavar="CODE",
            help="Take only findings whose code begins so: RTU, RTU-1, FT1A-Q16. Repeatable, or "
            "with commas.",
        ),
    ] = None,
    ignore: Annotated[
        list[str] | None,
        typer.Option(
            "--ignore",
            metavar="CODE",
            help="Leave out findings whose code begins so. Where --select fits, too, the longer "
            "one counts.",
        ),
    ] = None,
    start: StartOption = None,
    end: EndOption = None,
    limit: Annotated[
        list[str] | None,
        typer.Option(
            "--limit",
            metavar="CODE=NUMBER/TIME",
            help="How many cases within which time are an attack or a scan: SEC-201=20/60s. The "
            "time is in ms, s, min or h. docs/findings.md lists the defaults. Repeatable.",
        ),
    ] = None,
    baseline: Annotated[
        list[str] | None,
        typer.Option(
            "--baseline",
            metavar="GOOD",
            help="A capture or log of a time when all was well: what values do there is usual, "
            "too. Repeatable.",
        ),
    ] = None,
    format_: Annotated[
        CheckFormat | None,
        typer.Option(
            "--format", help="How to print. [default: table, or what the name of --output says]"
        ),
    ] = None,
    output: Annotated[
        str | None,
        typer.Option(
            "--output", "-o", metavar="OUT", help="Write to a file: .json, .sarif, .xml or .txt."
        ),
    ] = None,
    overwrite: OverwriteOption = False,
    each: Annotated[
        bool,
        typer.Option(
            "--all", help="In a table, a line for each finding, not for each code and place."
        ),
    ] = False,
) -> None:
    """Find what is wrong, why, and what to do.

    Rules of a device are held where --device, or the log itself, says which stands where. Exit code
    1 means that something is wrong, 0 that nothing is. docs/troubles.md explains the codes of
    troubles, docs/findings.md those of broken rules.
    """
    from mbtool.cli.output import as_output_error, opened, say_if_empty, verdict_kept
    from mbtool.devices.checking.security_limits import SecurityLimits
    from mbtool.workflows.check import CheckRun, CodeFilter

    files, baseline = named_files(files), named_files(baseline or ())
    options = capture.read()
    codes = CodeFilter.parse(select or (), ignore or ())
    window = TimeWindow.parse(start, end)
    run = CheckRun(files, options, codes, SecurityLimits.parse(limit or ()), window)
    run.demand_codes()
    demand_other_file([*files, *baseline], output)
    path = named_file(output)
    chosen = chosen_format(format_, path, _SUFFIXES, CheckFormat.TABLE)
    broken: InputError | None = None
    if baseline:
        demand_new(path, overwrite=overwrite)
        with say_if_interrupted():
            run.reading.demand_files()
            for remark in run.learn(baseline, with_progress):
                say(remark)
    stays = is_old(path)
    with (
        verdict_kept(lambda: run.is_anything_wrong),
        opened(path, run.reading.demand_files, overwrite=overwrite) as (file, name),
        as_output_error(name),
        interruptible() as interrupt,
        _finished(
            file,
            _printer(chosen, file, files, each=each),
            run,
            path,
            stays=stays,
        ) as printer,
    ):
        try:
            for found in interrupt.breakable(run.findings(with_progress)):
                printer.add(found)
            run.reading.demand_readable()
        except InputError as error:
            if not (run.transactions or run.counts):
                raise
            broken = error  # The rest of the files cannot be read; findings so far are kept.
    if broken is not None:
        raise broken
    say_if_empty(run.reading)
    if run.norm_remark is not None:
        say(run.norm_remark)
    if run.is_anything_wrong:
        raise typer.Exit(exit_codes.NO)


@contextmanager
def _finished(
    file: TextIO,
    printer: _Printer,
    run: CheckRun,
    path: str | None,
    *,
    stays: bool,
) -> Iterator[_Printer]:
    """Yield the printer, and complete the output when the context ends.

    Then print the remarks, and, if anything was checked, a sentence with the numbers of troubles
    and findings.
    `path` is the output file, None for standard output. If Ctrl-C or an InputError ends the
    context, nothing is left in the file; with `stays`, an older file at `path` stays as it was.
    """
    stays_text = f"{path} stays as it was"
    try:
        yield printer
    except InputError as error:
        if path is None:
            printer.end(run, str(error))
        else:
            emptied(file)
        for remark in [*run.remarks, *([stays_text] if stays else [])]:
            say(remark)
        raise
    except KeyboardInterrupt:
        if path is None:
            printer.end(run, "interrupted")
            file.flush()
            say("interrupted; what follows from the rest of the files is not there")
            _sum_up(run, path)
        else:
            emptied(file)
            say(f"interrupted; {stays_text}" if stays else NOTHING_WRITTEN)
        raise Interrupted from None
    printer.end(run, run.problem)
    file.flush()
    for remark in run.remarks:
        say(remark)
    if run.transactions or run.counts or not run.is_outside:
        _sum_up(run, path)


class _Printer(ABC):
    @abstractmethod
    def add(self, found: FileFinding) -> None: ...

    def end(self, run: CheckRun, why_partial: str | None) -> None:  # noqa: B027 - one has no rest
        """Print the findings that this printer has collected but not yet printed.

        `why_partial` says why a part of the files was not checked; None if all was.
        """


def _printer(format_: CheckFormat, file: TextIO, files: list[str], *, each: bool) -> _Printer:
    if format_ is CheckFormat.TABLE and each:
        return _EachPrinter(file)
    if format_ is CheckFormat.TABLE:
        return _FindingsTablePrinter(file, names_files=len(files) > 1)
    if format_ is CheckFormat.JUNIT:
        return _JUnitPrinter(file)
    return _DocumentPrinter(file, format_, files)


class _FindingsTablePrinter(_Printer):
    def __init__(self, file: TextIO, *, names_files: bool) -> None:
        from mbtool.troubles.broken_rules import Summaries

        self._file = file
        self._names_files = names_files
        self._summaries = Summaries()

    def add(self, found: FileFinding) -> None:
        self._summaries.add(found.finding, found.file if self._names_files else "")

    def end(self, run: CheckRun, why_partial: str | None) -> None:
        from mbtool.cli.console import PipeConsole
        from mbtool.views.findings_table import print_summaries

        console = PipeConsole(file=self._file)
        _print_troubles(console, run)
        print_summaries(console, self._summaries)


class _EachPrinter(_Printer):
    def __init__(self, file: TextIO) -> None:
        from mbtool.cli.console import PipeConsole

        self._console = PipeConsole(file=file)

    def add(self, found: FileFinding) -> None:
        from mbtool.views.findings_table import finding_line

        self._console.print(finding_line(found.finding), soft_wrap=True)

    def end(self, run: CheckRun, why_partial: str | None) -> None:
        _print_troubles(self._console, run)


def _print_troubles(console: Console, run: CheckRun) -> None:
    """Print the troubles, except for broken rules, which stand among the findings."""
    from rich.text import Text

    from mbtool.troubles.words import WORDS
    from mbtool.views.trouble_lines import STYLES, trouble_text

    for one in run.judgement().troubles:
        if one.code in WORDS:
            console.print(Text(f"! {trouble_text(one)}", STYLES[one.severity]), soft_wrap=True)


class _JUnitPrinter(_Printer):
    """Writes each trouble as a failed test; one that passed if there is none."""

    def __init__(self, file: TextIO) -> None:
        self._file = file

    def add(self, found: FileFinding) -> None:
        pass  # The troubles include broken rules.

    def end(self, run: CheckRun, why_partial: str | None) -> None:
        from mbtool.views.junit import Case, junit_xml
        from mbtool.views.trouble_lines import trouble_text

        judgement = run.judgement()
        cases = [
            Case(one.link, f"{one.code} {one.who}", [trouble_text(one)])
            for one in judgement.troubles
        ]
        if why_partial is not None:
            cases.append(Case("files", "can be read", error=why_partial))
        self._file.write(junit_xml("mbtool check", cases or [Case("all links", judgement.summary)]))


class _DocumentPrinter(_Printer):
    def __init__(self, file: TextIO, format_: CheckFormat, files: list[str]) -> None:
        from mbtool.sources.files import shown_name
        from mbtool.views.findings_document import Document, JsonDocument, SarifDocument

        self._file = file
        self._document: Document
        if format_ is CheckFormat.JSON:
            self._document = JsonDocument(__version__)
        else:
            self._document = SarifDocument(__version__, {shown_name(one): one for one in files})
        file.write(self._document.begin())

    def add(self, found: FileFinding) -> None:
        self._file.write(self._document.add(found.finding, found.file))

    def end(self, run: CheckRun, why_partial: str | None) -> None:
        from mbtool.views.findings_document import Checked

        remarks = [*run.remarks, *([] if why_partial is None else [why_partial])]
        is_whole = why_partial is None
        counts = run.transactions, run.failed_requests()
        self._file.write(self._document.end(Checked(*counts, run.judgement(), remarks, is_whole)))


def _sum_up(run: CheckRun, path: str | None) -> None:
    say(_sentence(run) + ("" if path is None else f" -> {path}"))


def _sentence(run: CheckRun) -> str:
    """Sum up a run: `14 findings of 3 codes in 8,120 transactions; docs/findings.md ...`."""
    from mbtool.troubles.words import WORDS

    judgement = run.judgement()
    number, codes = run.counts.total(), len(run.counts)
    transactions = counted(run.transactions, "transaction")
    troubles = sum(one.code in WORDS for one in judgement.troubles)
    parts = [counted(troubles, "trouble", ",")] if troubles else []
    if troubles and not run.is_anything_wrong:
        parts[0] += " of severity note (exit code 0)"
    if number:
        of_codes = "" if number == 1 else f" of {counted(codes, 'code')}"
        parts.append(f"{counted(number, 'finding')}{of_codes}")
    if parts:
        pages = ["docs/troubles.md"] if troubles else []
        pages += ["docs/findings.md"] if number else []
        verb = "explain the codes" if len(pages) > 1 else "explains each code"
        return f"{', '.join(parts)} in {transactions}; {' and '.join(pages)} {verb}"
    if not run.transactions:
        return f"no findings in {transactions}"
    return f"no findings in {transactions}. {judgement.summary}"
