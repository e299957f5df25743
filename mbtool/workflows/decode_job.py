"""Decodes many captures in parallel processes, with a Parquet file as the result for each."""

# The job lists the captures, and the records in the output that say which are decoded already. It
# divides the others into runs (cluster/plan.py), consecutive files for one decoder, and lets the
# processes of an executor decode these (decode_run.py). If the job is killed, the next job finds
# the records of the files that were decoded, and goes on with the others.

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from itertools import takewhile
from os.path import abspath

import msgspec

from mbtool.cluster.executors import DaskCluster, Executor, LocalProcesses
from mbtool.cluster.plan import (
    MAX_FILES,
    Around,
    FileRun,
    InputFile,
    files_each,
    path_name,
    plan,
    record_name,
    remaining,
    share_of,
)
from mbtool.cluster.store import OutputStore, is_store_address, list_inputs
from mbtool.sources.child import start_child
from mbtool.workflows.decode_run import DONE, FAILED, RECORDS, DecodeTask, FileOutcome, decode_run


@dataclass(frozen=True, slots=True, kw_only=True)
class JobOptions:
    """The TCP ports to decode, and which of the captures this job decodes."""

    ports: Sequence[int] = ()
    rtu_ports: Sequence[int] = ()
    any_port: bool = False
    is_anew: bool = False
    """True to decode captures again that an earlier job has decoded."""
    share: tuple[int, int] | None = None
    """For a job that several machines share: the number of this machine's part, from 0, and the
    number of all parts. None to decode all captures."""

    @property
    def text(self) -> str:
        """A text with the options that change the result.

        Each record that marks a capture as decoded has the hash of this text in its name. So a job
        with other options decodes the captures again.
        """
        return f"{sorted(self.ports)} {sorted(self.rtu_ports)} {self.any_port}"


@dataclass(slots=True)
class DecodeJob:
    """Decodes the captures whose paths match patterns. The results go into a folder, or to a prefix
    of an object store.
    """

    patterns: Sequence[str]
    output: str
    options: JobOptions
    files: int = 0
    """The number of captures found; with `options.share`, only those of this machine's part."""
    done_before: int = 0
    failed_before: list[FileOutcome] = field(default_factory=list)
    """The outcomes of captures that an earlier job decoded, but could not read to their ends."""

    def run(self, executor: Executor) -> Iterator[FileOutcome]:
        """Decode the captures that are not decoded yet, with the processes of `executor`, and yield
        the outcome of each.

        Raises InputError if there are no captures, UsageError if the output folder cannot be made,
        and OutputError if it cannot be used.
        """
        tasks = self._tasks(executor.processes)
        for data, result in executor.run([msgspec.json.encode(one) for one in tasks]):
            if isinstance(result, bytes):
                yield from msgspec.json.decode(result, type=list[FileOutcome])
                continue
            for file in msgspec.json.decode(data, type=DecodeTask).run.files:
                yield FileOutcome(
                    path=file.path, size=file.size, changed_ns=file.changed_ns, error=result
                )

    def __post_init__(self) -> None:
        if not is_store_address(self.output):
            self.output = abspath(self.output)

    def _tasks(self, processes: int) -> list[DecodeTask]:
        files = {one.path: one for pattern in self.patterns for one in list_inputs(pattern)}
        share = self.options.share
        # Several machines that share a job may start at different times and find a different number
        # of files, but must divide the files into the same runs. So the size of a run may not
        # depend on that number.
        most = files_each(len(files), processes) if share is None else MAX_FILES
        runs = plan(files.values(), most)
        if share is not None:
            runs = [one for one in runs if share_of(one, share[1]) == share[0]]
        self.files = sum(len(one.files) for one in runs)
        OutputStore(self.output).make(RECORDS)
        records = self._records()
        tasks = []
        for run in runs:
            for left in remaining(run, lambda *two: self._is_done(records, *two)):
                tasks.append(self._task(left, records))
        left_files = sum(len(one.run.files) for one in tasks)
        self.done_before = self.files - left_files
        return tasks

    def _records(self) -> dict[str, list[str]]:
        """The names of all records in the output. They are grouped by the part of the name before
        `-`, which stands for the path of a capture.
        """
        records: dict[str, list[str]] = {}
        for name in OutputStore(self.output).names(RECORDS):
            if name.endswith(DONE):
                records.setdefault(name.partition("-")[0], []).append(name)
        return records

    def _is_done(self, records: dict[str, list[str]], file: InputFile, around: Around) -> bool:
        if self.options.is_anew:
            return False
        name = record_name(file, around, self.options.text)
        known = records.get(path_name(file.path), ())
        if name + FAILED in known:
            data = OutputStore(self.output).read(f"{RECORDS}/{name}{FAILED}")
            self.failed_before.append(msgspec.json.decode(data, type=FileOutcome))
            return True
        return name + DONE in known

    def _task(self, run: FileRun, records: dict[str, list[str]]) -> DecodeTask:
        options = self.options
        return DecodeTask(
            run=run,
            output=self.output,
            folders=[self._folder(one) for one in run.files],
            records=[
                record_name(one, around, options.text)
                for one, around in zip(run.files, run.around, strict=True)
            ],
            older=[records.get(path_name(one.path), []) for one in run.files],
            ports=[*options.ports],
            rtu_ports=[*options.rtu_ports],
            any_port=options.any_port,
        )

    def _folder(self, file: InputFile) -> str:
        """The folder for a capture's Parquet file, below the output: the folders in the capture's
        path, without the leading ones that all patterns share.
        """
        base = _common_folders(self.patterns)
        return "/".join(file.path.split("/")[len(base) : -1])


def local_processes(processes: int) -> LocalProcesses:
    """Return an executor that starts `processes` processes on this machine."""
    return LocalProcesses(lambda: start_child("mbtool.workflows.decode_run"), processes)


def dask_cluster(address: str) -> DaskCluster:
    """Return an executor that uses the workers of the Dask scheduler at `address`.

    Raises UsageError if dask is not installed, LinkError if no scheduler answers.
    """
    return DaskCluster(address, decode_run)


def _common_folders(patterns: Sequence[str]) -> list[str]:
    """The names of the leading folders, from the root on, that are the same in all patterns and
    contain no `*`.
    """
    folders = []
    for pattern in patterns:
        parts = (pattern if is_store_address(pattern) else abspath(pattern)).split("/")[:-1]
        folders.append([*takewhile(lambda part: "*" not in part, parts)])
    return [one[0] for one in takewhile(lambda one: len({*one}) == 1, zip(*folders, strict=False))]
