"""mbtool decode of many captures into a folder or an object store: a Parquet file for each."""

from __future__ import annotations

import os
import re
from dataclasses import dataclass
from itertools import chain
from typing import TYPE_CHECKING, Annotated

import typer

from mbtool.cli.column_output import cores
from mbtool.cli.option_groups import OptionGroup
from mbtool.cli.options import Format
from mbtool.cli.progress import Files, with_progress
from mbtool.cli.talk import interruption_told, say
from mbtool.core import InputError, UsageError
from mbtool.core.moments import counted

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from mbtool.workflows.shared.reading import ReadingOptions

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
        share=_share(group.share),
    )
    job = DecodeJob(files, output, chosen)
    executor = (
        local_processes(jobs or cores()) if group.cluster is None else dask_cluster(group.cluster)
    )
    decoded = transactions = 0
    failed = []
    kept = f"interrupted; what is decoded is in {output}, and the same command does the rest"
    with interruption_told(kept):
        outcomes = job.run(executor)
        first = next(outcomes, None)  # Then the number of files is known.
        left = Files(job.files - job.done_before)
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


def _share(text: str | None) -> tuple[int, int] | None:
    if text is None:
        return None
    match = _SHARE.fullmatch(text)
    if match is None or not int(match[1]) < int(match[2]):
        raise UsageError(f"--share {text}: I/N with I from 0 to N-1 is wanted, such as 0/100")
    return int(match[1]), int(match[2])
