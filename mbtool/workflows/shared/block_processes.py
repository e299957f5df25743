"""Starts processes that print the transactions which this process decodes, to use several cores."""

# The main process reads and decodes blocks of packets, in the order of the packets. Child processes
# (block_printing.py) turn the decoded blocks into lines or Parquet, so the output is the same as
# that of one process. A Parquet file is written by one child. Lines are made by several children in
# turn, and the main process prints them in order.
#
# The arrays of a block are passed through files in memory. Each child has SLOTS of these files, so
# that its next block waits there when it has finished one.
#
# Memory: SLOTS blocks for each child, and their lines.
#
# If a child is killed, the main process notices that its replies end. Each child is in a process
# group of its own (sources/child.py), so Ctrl-C reaches only the main process. A child ends when
# its standard input is closed.

from __future__ import annotations

import os
import pickle
import tempfile
from collections import deque
from collections.abc import Iterator
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
    from mbtool.columns.column_decoder import DecodedBlock

SLOTS = 2
"""The number of blocks that a child process has at once: the one that it prints, and the one that
waits."""
MOST_LINE_PROCESSES = 2
"""At most this many child processes make lines. Making the lines of a block takes about as long as
decoding it, so one decoding process cannot keep more of them busy."""

_MODULE = "mbtool.workflows.shared.block_printing"


class BlockProcesses:
    """The child processes that print decoded blocks. It is a context manager; leaving it ends the
    processes.
    """

    def __init__(self, format_: str, jobs: int, output: int | None = None) -> None:
        """Start at most `jobs` - 1 child processes, but at least one.

        `format_` is parquet, jsonl or csv. `output` is the file descriptor of the Parquet file;
        None for the other formats. Raises LinkError if the system starts no more processes.
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

    def __exit__(self, *_: object) -> None:
        self._kill()

    def printed(self, blocks: Iterator[DecodedBlock]) -> Iterator[PrintedBlock]:
        """Let the child processes print blocks; yield their replies in the order of the blocks.

        If `blocks` raises an error, it is raised after the replies for the earlier blocks. Raises
        OutputError if a child process is killed, and the OSError of a child process that cannot
        write.
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
                yield waiting.popleft().take()  # They take turns: it has the oldest block.
            process.send(block)
            waiting.append(process)
            number += 1
        for process in waiting:
            yield process.take()
        if error is not None:
            raise error

    def complete(self) -> TransactionCounts:
        """Complete the Parquet file; return the counts of all its transactions.

        Raises OutputError if the child process is killed, and its OSError if it cannot write.
        """
        (process,) = self._processes
        process.complete()
        return process.counts

    def _kill(self) -> None:
        for process in self._processes:
            process.kill()


class _BlockProcess:
    """A child process that prints decoded blocks, with the files in memory that pass the data to
    it, and the thread that reads its replies.
    """

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
        """The numbers of transactions by outcome that the child has printed, summed over its
        replies so far."""
        # A thread reads the child's replies from the pipe. The main thread does not, because Ctrl-C
        # could interrupt it in the middle of a reply, and the reply would be lost.
        self._receiver = Thread(target=self._receive, daemon=True)
        self._receiver.start()

    @property
    def is_full(self) -> bool:
        return self._sent - self._taken == SLOTS

    def send(self, block: DecodedBlock) -> None:
        """Send a block to the child process. Call it only if `is_full` is False."""
        number = self._sent % SLOTS
        buffers: list[pickle.PickleBuffer] = []
        slim = replace(block, passed=None)
        body = pickle.dumps(slim, pickle.HIGHEST_PROTOCOL, buffer_callback=buffers.append)
        sizes = write_pieces(self._slots[number], [body, *(one.raw() for one in buffers)])
        self._sent += 1
        assert self._process.stdin is not None
        with suppress(BrokenPipeError):  # The process has ended; `take` will raise the reason.
            self._process.stdin.write(f"{number} {' '.join(map(str, sizes))}\n".encode())

    def take(self) -> PrintedBlock:
        """Wait for the next reply of the child process, and return it with its lines.

        If the reply is an error, it is raised. Raises OutputError if the process has ended too
        early.
        """
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
        """Wait until the child process has printed all its blocks and ended.

        If the process replies with an error, it is raised. Raises OutputError if the process has
        ended too early.
        """
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
    """Wait for the next reply in the stream `replies` and return it. None if the stream ends before
    a reply or in the middle of one.
    """
    head = replies.read(SIZE.size)
    if len(head) < SIZE.size:
        return None
    (size,) = SIZE.unpack(head)
    data = replies.read(size)
    return pickle.loads(data) if len(data) == size else None


def _file_in_memory() -> int:
    """Create a file without a name and return its descriptor.

    The file is in memory if the system supports that; otherwise it is a temporary file on the disk.
    """
    if hasattr(os, "memfd_create"):
        return os.memfd_create("mbtool")
    with tempfile.TemporaryFile() as file:
        return os.dup(file.fileno())
