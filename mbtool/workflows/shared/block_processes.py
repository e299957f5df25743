"""Lets other processes print what this one decodes, so that both cores of a machine are used."""

# This process reads and decodes; that must be done in the order of the packets. Other processes
# (block_printing.py) make lines or Parquet of the decoded blocks. So the result is the same as that
# of one process, whatever the blocks hold. One process writes a Parquet file; lines are made by
# several in turn, and this one prints them in order.
#
# The arrays of a block go through files in memory. Each process has SLOTS of them, so that it finds
# the next block when it has printed one. Memory: SLOTS blocks for each process, and their lines.
#
# A process that is killed is found by the end of its replies. The processes are in groups of their
# own (child.py), so Ctrl-C reaches only this one. They end when their standard input does.

from __future__ import annotations

import os
import pickle
import tempfile
from collections import deque
from contextlib import suppress
from dataclasses import replace
from queue import SimpleQueue
from threading import Thread
from typing import TYPE_CHECKING, BinaryIO, Self

from mbtool.columns.table_counts import TransactionCounts
from mbtool.core import OutputError
from mbtool.sources.child import start_child
from mbtool.workflows.shared.block_pieces import (
    NO_FILE,
    SIZE,
    PrintedBlock,
    read_pieces,
    write_pieces,
)

if TYPE_CHECKING:
    from collections.abc import Iterator
    from types import TracebackType

    from mbtool.columns.column_decoder import DecodedBlock

SLOTS = 2
"""Blocks that a process has at once: one that it prints, and the next."""
MOST_LINE_PROCESSES = 2
"""More are not kept busy by one that decodes: lines take about as long as decoding."""

_MODULE = "mbtool.workflows.shared.block_printing"


class BlockProcesses:
    """The processes that print blocks. A context manager; its exit ends them."""

    def __init__(self, format_: str, jobs: int, output: int | None = None) -> None:
        """Start at most `jobs` - 1 processes, for one of the formats of block_printing.py.

        `output` is the descriptor of a Parquet file. Raises LinkError if the system starts no more
        processes.
        """
        most = MOST_LINE_PROCESSES if output is None else 1
        self._processes: list[_BlockProcess] = []
        try:
            for _ in range(max(1, min(jobs - 1, most))):
                self._processes.append(_BlockProcess(format_, output))
        except BaseException:
            self._kill()
            raise

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self._kill()

    def printed(self, blocks: Iterator[DecodedBlock]) -> Iterator[PrintedBlock]:
        """Print blocks, in order; if one raises an error, it is raised after those before it.

        Raises OutputError if a process is killed, and the OSError of one that cannot write.
        """
        waiting: deque[_BlockProcess] = deque()
        error: Exception | None = None
        number = 0
        while True:
            try:
                block = next(blocks, None)
            except Exception as caught:
                error = caught
                break
            if block is None:
                break
            if block.plain is None and not block.records:
                continue
            process = self._processes[number % len(self._processes)]
            if process.is_full:
                yield waiting.popleft().take()  # It is the same process: they take turns.
            process.send(block)
            waiting.append(process)
            number += 1
        for process in waiting:
            yield process.take()
        if error is not None:
            raise error

    def complete(self) -> TransactionCounts:
        """Complete the Parquet file, and return the counts of all its transactions.

        Raises as `printed` does.
        """
        (process,) = self._processes
        process.complete()
        return process.counts

    def _kill(self) -> None:
        for process in self._processes:
            process.kill()


class _BlockProcess:
    """One process that prints blocks."""

    def __init__(self, format_: str, output: int | None) -> None:
        self._slots = [_file_in_memory() for _ in range(SLOTS)]
        files = [*self._slots, *([] if output is None else [output])]
        try:
            self._process = start_child(
                _MODULE,
                format_,
                NO_FILE if output is None else str(output),
                *map(str, self._slots),
                files=files,
            )
        except BaseException:
            self._close_slots()
            raise
        self._sent = self._taken = 0
        self._replies: SimpleQueue[PrintedBlock | Exception | None] = SimpleQueue()
        self.counts = TransactionCounts()
        """The sum of all replies so far."""
        # A thread reads the replies: Ctrl-C in the middle of one would lose it.
        self._receiver = Thread(target=self._receive, daemon=True)
        self._receiver.start()

    @property
    def is_full(self) -> bool:
        return self._sent - self._taken == SLOTS

    def send(self, block: DecodedBlock) -> None:
        """Let a block be printed; there must be room."""
        number = self._sent % SLOTS
        buffers: list[pickle.PickleBuffer] = []
        slim = replace(block, passed=None)
        body = pickle.dumps(slim, pickle.HIGHEST_PROTOCOL, buffer_callback=buffers.append)
        sizes = write_pieces(self._slots[number], [body, *(one.raw() for one in buffers)])
        self._sent += 1
        assert self._process.stdin is not None
        with suppress(BrokenPipeError):  # It has ended: `take` will tell why.
            self._process.stdin.write(f"{number} {' '.join(map(str, sizes))}\n".encode())

    def take(self) -> PrintedBlock:
        """Wait for the next block that was printed."""
        reply = self._replies.get()
        if isinstance(reply, Exception):
            raise reply
        if reply is None:
            raise OutputError(self._why_ended())
        if reply.text_bytes:
            (data,) = read_pieces(self._slots[self._taken % SLOTS], [reply.text_bytes])
            reply.text = data.decode("utf-8", "surrogatepass")
        self._taken += 1
        return reply

    def complete(self) -> None:
        """Let the process print what it has, and end. Raises as `take` does."""
        assert self._process.stdin is not None
        self._process.stdin.close()
        self._receiver.join()
        while not self._replies.empty():
            reply = self._replies.get()
            if isinstance(reply, Exception):
                raise reply
        if self._process.wait():
            raise OutputError(self._why_ended())

    def kill(self) -> None:
        self._process.kill()
        self._process.wait()
        self._receiver.join()
        for pipe in (self._process.stdin, self._process.stdout):
            if pipe is not None:
                pipe.close()
        self._close_slots()

    def _receive(self) -> None:
        assert self._process.stdout is not None
        try:
            with os.fdopen(os.dup(self._process.stdout.fileno()), "rb") as replies:
                while (reply := _next_reply(replies)) is not None:
                    if isinstance(reply, PrintedBlock):
                        self.counts.add(reply.counts)
                    self._replies.put(reply)
        finally:
            self._replies.put(None)

    def _why_ended(self) -> str:
        status = self._process.wait()
        how = f"signal {-status}" if status < 0 else f"exit code {status}"
        return (
            f"a process that prints for this one has ended too early ({how}), as when memory is "
            "short; --jobs 1 uses one process"
        )

    def _close_slots(self) -> None:
        for slot in self._slots:
            os.close(slot)


def _next_reply(replies: BinaryIO) -> PrintedBlock | Exception | None:
    """Wait for the next reply; None at the end, also if it is in the middle of a reply."""
    head = replies.read(SIZE.size)
    if len(head) < SIZE.size:
        return None
    (size,) = SIZE.unpack(head)
    data = replies.read(size)
    return pickle.loads(data) if len(data) == size else None


def _file_in_memory() -> int:
    """The descriptor of a file that has no name, in memory where the system can do that."""
    if hasattr(os, "memfd_create"):
        return os.memfd_create("mbtool")
    with tempfile.TemporaryFile() as file:
        return os.dup(file.fileno())
