"""mbtool report: make one HTML page from captures, to hand over."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from mbtool.cli.option_groups import takes_groups
from mbtool.cli.options import (
    DeviceOption,
    EndOption,
    OverwriteOption,
    RawOption,
    SilenceOptions,
    SourceOptions,
    StartOption,
)

_OTHER_SUFFIXES = (".pdf", ".docx", ".odt", ".md", ".txt", ".csv", ".json", ".xml")
"""Suffixes that are refused, as other programs would take the page for something else."""


@takes_groups
def report(
    files: Annotated[
        list[str], typer.Argument(metavar="FILE", help="Captures and logs, as for decode.")
    ],
    *,
    output: Annotated[
        str, typer.Option("--output", "-o", metavar="OUT", help="The page to write: R.html.")
    ],
    overwrite: OverwriteOption = False,
    device: DeviceOption = None,
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
    raw: RawOption = False,
    source: SourceOptions,
    silences: SilenceOptions,
) -> None:
    """Make one page of captures, to read, print and hand over.

    It has the verdict, charts, findings and transactions, and needs no network and no other file.
    docs/report.md explains it.
    """
    from mbtool.cli.output import opened, told_as_lost
    from mbtool.cli.output_file import kept_told, left_told
    from mbtool.cli.output_path import demand_new, demand_other_file, named_file
    from mbtool.cli.progress import with_progress
    from mbtool.cli.talk import say
    from mbtool.core import UsageError
    from mbtool.core.wording import counted
    from mbtool.workflows.check import CodeFilter
    from mbtool.workflows.report import ReportRun
    from mbtool.workflows.shared.time_window import TimeWindow

    if against is not None and len(files) > 1:
        raise UsageError("--against goes with one FILE; join several with mbtool convert")
    if against is not None and (start is not None or end is not None):
        raise UsageError("--against compares whole captures; cut a part with mbtool convert first")
    demand_other_file([*files, *([] if against is None else [against])], output)
    path = named_file(output)
    if path is not None and Path(path).suffix.lower() in _OTHER_SUFFIXES:
        page = Path(path).with_suffix(".html")
        raise UsageError(f"{path}: the page is HTML: write -o {page}; a browser makes a PDF of it")
    with left_told(path):
        run = ReportRun(
            files,
            source.read(device, raw=raw, silences=silences),
            CodeFilter.parse((), ignore or ()),
            TimeWindow.parse(start, end),
            everything=everything,
        )
        run.demand_codes()
        run.reading.demand_files()
        demand_new(path, overwrite=overwrite)
        # The output is opened only after all inputs were read, so that an error does not overwrite
        # an older page.
        with kept_told(path):
            run.read(with_progress)
            run.reading.demand_readable()
            text = run.page(against, say)
        with opened(path, lambda: None, overwrite=overwrite) as (file, name), told_as_lost(name):
            file.write(text)
            file.flush()
    for remark in run.remarks:
        say(remark)
    if path is not None:
        done = counted(run.account.transactions, "transaction", ",")
        say(f"{done} -> {path} ({len(text) / 1e6:.1f} MB)")
    if run.error is not None:
        raise run.error
