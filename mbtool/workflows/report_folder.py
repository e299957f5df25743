"""Judges each capture of a folder by itself, for the page of `mbtool report FOLDER`."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import TYPE_CHECKING

from mbtool.core import InputError
from mbtool.ports.clock import now_ns
from mbtool.sources.files import shown_name
from mbtool.version import __version__
from mbtool.views.report.folder_page import UNREAD, FileVerdict, folder_page
from mbtool.views.trouble_lines import trouble_text
from mbtool.workflows.check import CheckRun, CodeFilter

if TYPE_CHECKING:
    from mbtool.query.where import Where
    from mbtool.views.report.contents import ReportWords
    from mbtool.workflows.shared.reading import ReadingOptions
    from mbtool.workflows.shared.time_window import TimeWindow


def file_verdicts(
    folder: str,
    files: Sequence[str],
    options: ReadingOptions,
    codes: CodeFilter,
    window: Callable[[], TimeWindow],
    wanted: Where | None,
) -> Iterator[FileVerdict]:
    """Yield the verdict of each file of a folder, one after the other.

    `codes` chooses the findings and troubles, `wanted` the transactions. `window` makes the part
    of a file that is judged, which may count from the file's own first request.
    """
    for file in files:
        run = CheckRun([file], options, codes, window=window(), wanted=wanted)
        error: InputError | None = None
        try:
            run.reading.demand_files()
            for _ in run.findings():
                pass
            run.reading.demand_readable()
        except InputError as found:
            error = found
        yield _verdict(run, shown_name(file), os.path.relpath(file, folder), error)


def page_of(folder: str, files: Iterable[FileVerdict], words: ReportWords) -> str:
    """Return the page about the files of a folder."""
    return folder_page(folder, list(files), words, __version__, now_ns())


def _verdict(run: CheckRun, file: str, shown: str, error: InputError | None) -> FileVerdict:
    """Judge a file, which messages call `file` and the page calls `shown`."""
    if error is not None and not run.transactions:
        return FileVerdict(file=shown, level=UNREAD, sentence=str(error).removeprefix(f"{file}: "))
    judgement = run.judgement()
    troubles = judgement.troubles
    sentence = trouble_text(troubles[0]) if troubles else judgement.summary
    if error is not None:
        sentence += f" ({str(error).removeprefix(f'{file}: ')})"
    if not run.transactions and run.reading.why_empty is not None:
        sentence = run.reading.why_empty.removeprefix(f"{file}: ")
    begins = [link.begin_ns for link in judgement.links if link.has_times]
    return FileVerdict(
        file=shown,
        level="doubt" if error is not None and judgement.level == "well" else judgement.level,
        sentence=sentence,
        troubles=len(troubles),
        transactions=run.transactions,
        failed=sum(run.failed_requests().values()),
        begin_ns=min(begins, default=None),
    )
