"""mbtool report: make one HTML page from captures, to hand over."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from mbtool.cli.option_groups import with_option_groups
from mbtool.cli.options import (
    CaptureOptions,
    EndOption,
    GuessedTypesOption,
    OverwriteOption,
    StartOption,
    WhereOption,
    condition,
    given_types,
)
from mbtool.cli.output_file import report_kept, report_left
from mbtool.cli.output_path import demand_new, demand_other_file, named_file
from mbtool.cli.progress import with_progress
from mbtool.cli.talk import say
from mbtool.core import InputError, UsageError
from mbtool.core.moments import counted
from mbtool.workflows.shared.named_files import is_folder, named_files
from mbtool.workflows.shared.read_all import CountedWork
from mbtool.workflows.shared.time_window import TimeWindow

if TYPE_CHECKING:
    from mbtool.views.report.contents import ReportWords
    from mbtool.views.report.folder_page import FileVerdict

_OTHER_SUFFIXES = (".pdf", ".docx", ".odt", ".md", ".txt", ".csv", ".json", ".xml")
"""Suffixes that are refused, as other programs would take the page for something else."""


@with_option_groups
def report(
    files: Annotated[
        list[str],
        typer.Argument(
            metavar="FILE",
            help="Captures and logs, as for decode. A folder gives a page with a line for each "
            "capture in it, the worst first.",
        ),
    ],
    *,
    output: Annotated[
        str, typer.Option("--output", "-o", metavar="OUT", help="The page to write: R.html.")
    ],
    overwrite: OverwriteOption = False,
    title: Annotated[
        str, typer.Option("--title", metavar="TEXT", help="A title of your own.")
    ] = "",
    note: Annotated[
        str,
        typer.Option("--note", metavar="TEXT", help="A note for the reader, under the verdict."),
    ] = "",
    capture: CaptureOptions,
    types: GuessedTypesOption = None,
    where: WhereOption = None,
    against: Annotated[
        str | None,
        typer.Option(
            "--against",
            metavar="OTHER",
            help="Compare with another capture or log, as diff does: how it was before.",
        ),
    ] = None,
    ignore: Annotated[
        list[str] | None,
        typer.Option(
            "--ignore",
            metavar="CODE",
            help="Leave out findings whose code begins so: RTU, RTU-1, FT1A-Q16. Repeatable, or "
            "with commas.",
        ),
    ] = None,
    everything: Annotated[
        bool,
        typer.Option(
            "--all",
            help="Put all transactions into the page. [default: the first 5,000, and those with "
            "something wrong]",
        ),
    ] = False,
    start: StartOption = None,
    end: EndOption = None,
) -> None:
    """Make one page of captures, to read, print and hand over.

    It has the verdict, charts, findings and transactions, and needs no network and no other file.
    docs/report.md explains it.
    """
    from mbtool.cli.output import as_output_error, opened
    from mbtool.views.report.contents import ReportWords
    from mbtool.workflows.check import CodeFilter
    from mbtool.workflows.report import ReportRun
    from mbtool.workflows.report_folder import file_verdicts

    folder = files[0] if len(files) == 1 and is_folder(files[0]) else None
    if folder is not None and (against is not None or everything):
        raise UsageError("--against and --all go with files, and not with a folder")
    files = named_files(files)
    if against is not None and len(files) > 1:
        raise UsageError("--against goes with one FILE; join several with mbtool convert")
    if against is not None and (start is not None or end is not None):
        raise UsageError("--against compares whole captures; cut a part with mbtool convert first")
    demand_other_file([*files, *([] if against is None else [against])], output)
    path = named_file(output)
    if path is not None and Path(path).suffix.lower() in _OTHER_SUFFIXES:
        page = Path(path).with_suffix(".html")
        raise UsageError(f"{path}: the page is HTML: write -o {page}; a browser makes a PDF of it")
    given, guesses = given_types(types)
    options = capture.read(given)
    codes = CodeFilter.parse((), ignore or ())
    wanted = None if where is None else condition(where)
    words = ReportWords(title, note, where or "")
    if folder is not None:
        verdicts = file_verdicts(
            folder, files, options, codes, lambda: TimeWindow.parse(start, end), wanted
        )
        _write_folder(folder, files, verdicts, words, path, overwrite=overwrite)
        return
    with report_left(path):
        run = ReportRun(
            files,
            options,
            codes,
            TimeWindow.parse(start, end),
            wanted=wanted,
            words=words,
            everything=everything,
        )
        run.guesses = guesses
        run.demand_codes()
        run.reading.demand_files()
        demand_new(path, overwrite=overwrite)
        # The output is opened only after all inputs were read, so that an error does not overwrite
        # an older page.
        with report_kept(path):
            run.read(with_progress)
            run.reading.demand_readable()
            text = run.page(against, say)
        with opened(path, lambda: None, overwrite=overwrite) as (file, name), as_output_error(name):
            file.write(text)
            file.flush()
    for remark in run.remarks:
        say(remark)
    if path is not None:
        done = counted(run.account.transactions, "transaction", ",")
        say(f"{done} -> {path} ({len(text) / 1e6:.1f} MB)")
    if run.error is not None:
        raise run.error


def _write_folder(
    folder: str,
    files: Sequence[str],
    verdicts: Iterator[FileVerdict],
    words: ReportWords,
    path: str | None,
    *,
    overwrite: bool,
) -> None:
    """Write the page with a line for each of `files` to `path`, None for standard output."""
    from mbtool.cli.output import as_output_error, opened
    from mbtool.views.report.folder_page import LEVELS, UNREAD
    from mbtool.workflows.report_folder import page_of

    work = CountedWork(len(files))
    with report_left(path):
        demand_new(path, overwrite=overwrite)
        found = list(with_progress(work, work.counted(verdicts)))
        text = page_of(folder, found, words)
        with opened(path, lambda: None, overwrite=overwrite) as (file, name), as_output_error(name):
            file.write(text)
            file.flush()
    levels = [one.level for one in found]
    told = [f"{levels.count(level):,} {LEVELS[level]}" for level in LEVELS if level in levels]
    if path is not None:
        say(f"{counted(len(found), 'file', ',')}: {', '.join(told)} -> {path}")
    if UNREAD in levels:
        raise InputError(f"{counted(levels.count(UNREAD), 'file', ',')} could not be read")
