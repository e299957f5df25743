"""Runs tasks in several processes: on this machine, or on the workers of a Dask cluster."""

# Results are given in the order in which they come. If a process is killed, its task is given to
# another process, at most RETRIES times. A task and a result are bytes; nothing else passes between
# processes.

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from contextlib import suppress
from typing import TYPE_CHECKING, Protocol

from mbtool.core import LinkError
from mbtool.core.extras import missing_extra

if TYPE_CHECKING:
    import subprocess

    Work = Callable[[bytes], bytes]

RETRIES = 2
CONNECT_S = 20


class Executor(Protocol):
    """Runs tasks in several processes."""

    processes: int
    """The greatest number of tasks that run at the same time."""

    def run(self, tasks: Sequence[bytes]) -> Iterator[tuple[bytes, bytes | str]]:
        """Yield pairs of a task and its result, in the order in which the tasks end.

        A task is bytes that the caller has serialised, and so is its result. If the task failed,
        the result is a text with the reason.
        """


class LocalProcesses:
    """Runs tasks in processes of this machine, which read them from their standard input."""

    def __init__(self, start: Callable[[], subprocess.Popen[bytes]], processes: int) -> None:
        """`start` starts a process that reads tasks and writes results.

        At most `processes` run at once. A task is one line on the process's standard input: its
        bytes in hexadecimal digits. The process answers it with one such line on standard output,
        the bytes of the result.
        """
        self.processes = processes
        self._start = start
        self._lock = threading.Lock()
        self._idle: list[subprocess.Popen[bytes]] = []
        self._all: set[subprocess.Popen[bytes]] = set()
        self._is_ended = False

    @property
    def pids(self) -> list[int]:
        """The ids of all processes that were started so far, also of those that have ended."""
        with self._lock:
            return [one.pid for one in self._all]

    def run(self, tasks: Sequence[bytes]) -> Iterator[tuple[bytes, bytes | str]]:
        count = min(self.processes, len(tasks)) or 1
        pool = ThreadPoolExecutor(count)
        try:
            pending = {pool.submit(self._result, task): task for task in tasks}
            for future in as_completed(pending):
                yield pending[future], future.result()
        finally:
            self._end()
            pool.shutdown(cancel_futures=True)

    def _result(self, task: bytes) -> bytes | str:
        status = 0
        for _ in range(1 + RETRIES):
            with self._lock:
                if self._is_ended:
                    return "interrupted"
                process = self._idle.pop() if self._idle else self._start()
                self._all.add(process)
            line = b""
            with suppress(OSError, ValueError):
                assert process.stdin is not None
                assert process.stdout is not None
                process.stdin.write(task.hex().encode() + b"\n")
                line = process.stdout.readline()
            if line.endswith(b"\n"):
                with self._lock:
                    self._idle.append(process)
                return bytes.fromhex(line.decode())
            status = process.wait()
        how = f"by signal {-status}" if status < 0 else f"with exit code {status}"
        return f"its process ended {how}, {1 + RETRIES} times"

    def _end(self) -> None:
        with self._lock:
            self._is_ended = True
            for process in self._all:
                process.kill()
        for process in self._all:
            process.wait()
            for pipe in (process.stdin, process.stdout):
                if pipe is not None:
                    pipe.close()


class DaskCluster:
    """Runs tasks on the workers of a Dask scheduler. Each must have mbtool[cluster] installed."""

    def __init__(self, address: str, work: Work) -> None:
        """Connect to the scheduler at `address`; its workers call `work` with each task's bytes.

        Raises UsageError if dask is not installed, and LinkError if no scheduler answers.
        """
        try:
            from distributed import Client
        except ImportError:
            raise missing_extra("--cluster", "cluster") from None
        try:
            self._client = Client(address, timeout=CONNECT_S, set_as_default=False)
        except (OSError, ValueError) as error:
            raise LinkError(f"{address}: no Dask scheduler answers: {error}") from error
        self._work = work
        self.processes = max(sum(self._client.nthreads().values()), 1)

    def run(self, tasks: Sequence[bytes]) -> Iterator[tuple[bytes, bytes | str]]:
        from distributed import as_completed as completed

        futures = [
            self._client.submit(self._work, task, pure=False, retries=RETRIES) for task in tasks
        ]
        by_key = {future.key: task for future, task in zip(futures, tasks, strict=True)}
        try:
            for future in completed(futures, loop=self._client.loop):
                task = by_key[future.key]
                error = future.exception()
                yield task, future.result() if error is None else _error_text(error)
                future.release()
        finally:
            self._client.cancel(futures)
            self._client.close()


def _error_text(error: BaseException) -> str:
    return " ".join(f"{type(error).__name__}: {error}".split())
