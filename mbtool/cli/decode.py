"""mbtool decode: print the transactions of captures and logs."""

from __future__ import annotations

import os
import re
import stat
import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import chain
from typing import TYPE_CHECKING, Annotated

import typer

from mbtool.cli.column_output import cores, print_columns, processes_for
from mbtool.cli.option_groups import OptionGroup, with_option_groups
from mbtool.cli.options import (
    FORMATS,
    CaptureOptions,
    EndOption,
    EventChoice,
    EventsOption,
    Format,
    JobsOption,
    OverwriteOption,
    SilenceOptions,
    SortKey,
    StartOption,
    TableOptionGroup,
    TypesOption,
    WhereOption,
    condition,
)
from mbtool.cli.output_path import demand_other_file
from mbtool.cli.progress import with_progress
from mbtool.cli.talk import interruptible, say, say_if_interrupted
from mbtool.core import InputError, UsageError, WireEvent
from mbtool.core.moments import counted
from mbtool.workflows.shared.named_files import named_files
from mbtool.workflows.shared.read_all import CountedWork
from mbtool.workflows.shared.time_window import TimeWindow

if TYPE_CHECKING:
    from mbtool.decode.decoder import Record
    from mbtool.workflows.shared.column_reading import ColumnReading
    from mbtool.workflows.shared.model_hints import ModelHints
    from mbtool.workflows.shared.reading import Reading, ReadingOptions

# mbtool decode of many captures into a folder or an object store: a Parquet file for each.

_SHARE = re.compile(r"(\d+)/(\d+)")
_SCHEDULER = re.compile(r"[a-z]+://.+:\d+")
_OBJECT_STORE = re.compile(r"[a-zA-Z][a-zA-Z0-9+.-]+://")


@dataclass(frozen=True, slots=True)
class JobOptionGroup(OptionGroup):
    """The options --cluster and --share, which divide the decoding of many captures."""

    cluster: Annotated[
        str | None,
        typer.Option(
            "--cluster",
            metavar="ADDRESS",
            help="Decode on the workers of this Dask scheduler: tcp://scheduler:8786. With "
            "--format parquet and a folder as --output.",
        ),
    ] = None
    share: Annotated[
        str | None,
        typer.Option(
            "--share",
            metavar="I/N",
            help="Decode the part I (0 to N-1) of N parts of the captures, for machines that share "
            "a job without a scheduler. With a folder as --output.",
        ),
    ] = None


def is_job(files: Sequence[str], output: str | None, group: JobOptionGroup) -> bool:
    """True if each capture is to be decoded into a Parquet file of its own.

    That is so with --cluster or --share, if an input or the output is in an object store (a URL),
    and if the output is a folder.
    """
    return (
        group.cluster is not None
        or group.share is not None
        or any(_OBJECT_STORE.match(one) for one in (*files, output or ""))
        or (output is not None and (output.endswith("/") or os.path.isdir(output)))
    )


def run_job(
    files: Sequence[str],
    output: str | None,
    format_: Format | None,
    options: ReadingOptions,
    group: JobOptionGroup,
    jobs: int | None,
    *,
    overwrite: bool,
) -> None:
    """Decode each file into a Parquet file in the folder `output`, and print the number of decoded
    files.

    `jobs` is the number of processes, None for one per core. Raises UsageError if options do not
    fit, and InputError after the last file if one could not be read to its end.
    """
    from mbtool.cli.printers import demand_columns

    if output is None or format_ is not Format.PARQUET:
        if output is not None and group == JobOptionGroup() and os.path.isdir(output):
            raise UsageError(
                f"{output}: a directory; name a file in it, or give --format parquet, which writes "
                "a file for each capture"
            )
        raise UsageError(
            "a folder, an object store, --cluster and --share go with --format parquet -o FOLDER/"
        )
    if group.cluster is None:
        demand_columns()
    elif _SCHEDULER.fullmatch(group.cluster):
        demand_columns("--cluster", "cluster")
    else:
        raise UsageError(f"--cluster {group.cluster}: tcp://HOST:PORT of a scheduler is wanted")
    from mbtool.workflows.decode_job import DecodeJob, JobOptions, dask_cluster, local_processes

    chosen = JobOptions(
        ports=options.ports,
        rtu_ports=options.rtu_ports,
        any_port=options.any_port,
        is_anew=overwrite,
        share=_parse_share(group.share),
    )
    job = DecodeJob(files, output, chosen)
    executor = (
        local_processes(jobs or cores()) if group.cluster is None else dask_cluster(group.cluster)
    )
    decoded = transactions = 0
    failed = []
    kept = f"interrupted; what is decoded is in {output}, and the same command does the rest"
    with say_if_interrupted(kept):
        outcomes = job.run(executor)
        first = next(outcomes, None)  # Then the number of files is known.
        left = CountedWork(job.files - job.done_before)
        every = chain([] if first is None else [first], outcomes)
        for outcome in with_progress(left, left.counted(every)):
            decoded += 1
            transactions += outcome.transactions
            if outcome.error:
                failed.append(outcome)
    failed += job.failed_before
    for outcome in sorted(failed, key=lambda one: one.path):
        why = outcome.error.removeprefix(f"{outcome.path}: ")
        say(f"{outcome.path}: {'read in part' if outcome.parquet else 'not read'}: {why}")
    before = f", {job.done_before:,} done before" if job.done_before else ""
    say(
        f"{counted(job.files, 'file')}{before}, {decoded:,} decoded: "
        f"{counted(transactions, 'transaction')} -> {output}"
    )
    if failed:
        raise InputError(
            f"{len(failed):,} of {counted(job.files, 'file')} could not be read to "
            f"{'its end' if len(failed) == 1 else 'their ends'}"
        )


def refuse_others(given: Mapping[str, object]) -> None:
    """Raise UsageError if an option is given that `decode` into a folder does not support.

    `given` maps the names of these options to their values.
    """
    wrong = [name for name, value in given.items() if value]
    if wrong:
        raise UsageError(
            f"{', '.join(wrong)}: not with a folder of Parquet files; query these instead "
            "(docs/scale.md)"
        )


def _parse_share(text: str | None) -> tuple[int, int] | None:
    if text is None:
        return None
    match = _SHARE.fullmatch(text)
    if match is None or not int(match[1]) < int(match[2]):
        raise UsageError(f"--share {text}: I/N with I from 0 to N-1 is wanted, such as 0/100")
    return int(match[1]), int(match[2])


STANDARD_INPUT = "-"
_LOOK_AGAIN_S = 0.2
"""With --follow, the time in s between two attempts to read new records from the log."""


@with_option_groups
def decode(
    files: Annotated[
        list[str],
        typer.Argument(
            metavar="FILE",
            help="Captures (.pcap, .pcapng), logs (.mcap) or bytes of a serial line (.csv with "
            "byte times, .sr of sigrok; others with --link), plain, .gz or .zst; - is standard "
            "input. Several captures are read as parts of one.",
        ),
    ],
    *,
    capture: CaptureOptions,
    types: TypesOption = None,
    where: WhereOption = None,
    format_: Annotated[
        Format | None,
        typer.Option(
            "--format", help="How to print. [default: table, or what the name of --output says]"
        ),
    ] = None,
    output: Annotated[
        str | None,
        typer.Option(
            "--output",
            "-o",
            metavar="OUT",
            help=f"Write to a file: {', '.join(FORMATS)}; with --format parquet "
            "also into a folder, here or in an object store (s3://...): a file for each capture.",
        ),
    ] = None,
    points: Annotated[
        str | None,
        typer.Option(
            "--points",
            metavar="OUT",
            help="With -o OUT.parquet: a second Parquet file with a row for each value.",
        ),
    ] = None,
    overwrite: OverwriteOption = False,
    start: StartOption = None,
    end: EndOption = None,
    limit: Annotated[
        int | None,
        typer.Option("--limit", metavar="N", min=1, help="Stop after so many transactions."),
    ] = None,
    follow: Annotated[
        bool, typer.Option("--follow", help="Go on as a log that is being written grows.")
    ] = False,
    sunspec: Annotated[
        str | None,
        typer.Option(
            "--sunspec",
            metavar="FOLDER",
            help="Name SunSpec devices by the models that they say they have; FOLDER is a copy of "
            "json of github.com/sunspec/models. Files are read twice.",
        ),
    ] = None,
    events: EventsOption = None,
    table: TableOptionGroup,
    sort: Annotated[
        SortKey | None,
        typer.Option(
            "--sort",
            help="Order of the rows; all of them are held until the end. Without it, a row comes "
            "when it is sure how its transaction ended.",
        ),
    ] = None,
    jobs: JobsOption = None,
    group: JobOptionGroup,
) -> None:
    """Decode captures and logs into transactions, a line for each."""
    from mbtool.cli.output import open_output, say_if_empty
    from mbtool.workflows.shared.log_records import followed
    from mbtool.workflows.shared.model_hints import ModelHints
    from mbtool.workflows.shared.unreadable_lines import UnreadableLines

    link = capture.source.link
    if follow and (capture.raw or link is not None or sunspec is not None or len(files) > 1):
        raise UsageError("--follow goes with one log, and not with --raw, --link or --sunspec")
    if follow and sort is not None:
        raise UsageError("--follow prints each row as it comes; --sort needs all of them first")
    if not is_job(files, output, group):
        files = named_files(files)
    else:
        refuse_others({
            "--device": capture.device, "--types": types, "--where": where, "--start": start,
            "--end": end, "--limit": limit, "--follow": follow, "--raw": capture.raw,
            "--link": link,
            "--sunspec": sunspec, "--events": events, "--sort": sort, "--points": points,
            "--t1-5, --t3-5, --response-timeout": capture.silences != SilenceOptions(),
            "options of the table": table != TableOptionGroup(),
        })  # fmt: skip
        read = capture.source.read()
        run_job(files, output, format_, read, group, jobs, overwrite=overwrite)
        return
    for path in (output, points):
        demand_other_file(files, path)
    window = TimeWindow.parse(start, end)
    fits = condition(where)
    wanted = fits if window.is_whole else lambda one: one in window and fits(one)
    options = capture.read(types)
    if sunspec is not None:
        from mbtool.workflows.shared.sunspec_devices import SunSpecFolder, with_sunspec

        options = with_sunspec(files, options, SunSpecFolder(sunspec), say)
    is_whole = where is None and window.is_whole and limit is None and sort is None and not follow
    columns = _columns(files, options, format_, output, events) if is_whole else None
    reading = columns or _reading(files, options, output, is_cut=limit is not None or follow)
    hints = ModelHints(reading.profile_for)
    with (
        _with_remarks(reading, hints, window),
        open_output(
            output,
            format_,
            events,
            reading.profile_for,
            wanted,
            limit,
            reading.demand_files,
            table=table.read(),
            order=sort,
            overwrite=overwrite,
            in_place=follow or (STANDARD_INPUT in files and _is_piped()),
            points=points,
            profile_named=reading.profile_named,
        ) as out,
        interruptible() as interrupt,
    ):

        def wait() -> bool:
            out.wait()
            return not interrupt.wait(_LOOK_AGAIN_S)

        if follow:
            records = followed(files[0], options.assignments, wait)
        else:
            records = interrupt.breakable(reading.records())
        # A live capture may come through a pipe, so each line is printed at once, even into a pipe.
        is_live = STANDARD_INPUT in files and (out.on_terminal or _is_piped())
        lines = UnreadableLines(lambda link: reading.line_of(link))

        def note(record: Record) -> None:
            hints.note(record)
            if (doubt := lines.note(record)) is not None:
                say(f"mbtool: {doubt}")

        if columns is not None and out.printer.takes_many:
            records = iter(())
            print_columns(columns, out, note, interrupt, processes_for(files, jobs))
        if not (follow or out.on_terminal):
            records = with_progress(reading, records)
        for record in window.begun(records, at_once=follow or is_live):
            note(record)
            if not isinstance(record, WireEvent) or record in window:
                out.add(record)
            if is_live:
                out.wait()
            if limit is not None and out.is_full:
                reading.results.raise_first()
                break
        else:
            for doubt in lines.untold():
                say(f"mbtool: {doubt}")
        if interrupt.asked:
            raise KeyboardInterrupt
        if not follow:
            reading.demand_readable()
    if not follow:
        say_if_empty(reading)


def _columns(
    files: list[str],
    options: ReadingOptions,
    format_: Format | None,
    output: str | None,
    events: EventChoice | None,
) -> ColumnReading | None:
    """Return a reading by the array decoder if format and files allow it, else None.

    Formats that allow it: Parquet; JSON lines and CSV without events; a table without all events (a
    `format_` of None is the table, unless the suffix of `output` means another format). If None is
    returned, the caller decodes the transactions one by one.
    """
    from mbtool.cli.printers import demand_columns
    from mbtool.workflows.shared.reading_choice import column_reading

    suffix = os.path.splitext(output or "")[1].lower()
    match format_ or FORMATS.get(suffix):
        case Format.PARQUET:
            demand_columns()
            return column_reading(files, options, at_least=0)  # pyarrow needs numpy anyway.
        case _ if _is_shown(output):
            return None
        case Format.JSONL | Format.CSV if events in (None, EventChoice.NONE):
            return column_reading(files, options)
        case Format.TABLE | None if events is not EventChoice.ALL:
            return column_reading(files, options)
    return None


def _reading(
    files: list[str], options: ReadingOptions, output: str | None, *, is_cut: bool
) -> Reading:
    """Return a reading that yields records one by one.

    It uses the array decoder where that is faster. `is_cut` is True if the files may not be read to
    their end, such as with --limit or --follow; then it decodes packet by packet.
    """
    from mbtool.workflows.shared.reading import Reading
    from mbtool.workflows.shared.reading_choice import column_reading

    columns = None if is_cut or _is_shown(output) else column_reading(files, options)
    return columns or Reading(files, options)


def _is_shown(output: str | None) -> bool:
    """True if rows go to a terminal, where the first rows should appear at once, so that packets
    are decoded one by one. `output` is the path of the output file, None for standard output.
    """
    return output is None and sys.stdout is not None and sys.stdout.isatty()


@contextmanager
def _with_remarks(reading: Reading, hints: ModelHints, window: TimeWindow) -> Iterator[None]:
    """When the context ends, even by an error, print the remarks about the files.

    They come from the reading, from `hints` about device models, and from `window`, if no
    transaction lies between --start and --end.
    """
    try:
        yield
    finally:
        for remark in (*reading.remarks, *hints.remarks, window.why_empty):
            if remark is not None:
                say(remark)


def _is_piped() -> bool:
    """True if standard input is a pipe, a socket or a terminal, and not a regular file."""
    try:
        return not stat.S_ISREG(os.fstat(0).st_mode)
    except OSError:  # Standard input is closed: opening it will raise the error.
        return False
