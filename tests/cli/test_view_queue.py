"""The queue before a terminal or pipe: it never waits, and says when it is full."""

from __future__ import annotations

import io
import os
from contextlib import contextmanager, suppress
from typing import TYPE_CHECKING

import pytest

from mbtool.cli.view_queue import ViewQueue, unwaited
from tests.cli.program import full_pipe

if TYPE_CHECKING:
    from collections.abc import Iterator


@contextmanager
def a_pipe() -> Iterator[tuple[int, ViewQueue]]:
    """A pipe: the end to read, and a queue before the other."""
    reading, writing = os.pipe()
    try:
        with open(writing, "w", encoding="ascii") as file:
            yield reading, ViewQueue(file)
    finally:
        with suppress(OSError):
            os.close(reading)


def read(reading: int, count: int) -> bytes:
    data = b""
    while len(data) < count:
        data += os.read(reading, count - len(data))
    return data


def test_passes_on_all_text_in_order() -> None:
    text = "".join(f"{number}\n" for number in range(50_000))
    with a_pipe() as (reading, queue):
        for line in text.splitlines(keepends=True):
            queue.write(line)
        assert read(reading, len(text)) == text.encode()
        assert queue.drain(lambda: False)
        assert not queue.is_full


def test_escapes_what_the_encoding_lacks() -> None:
    with a_pipe() as (reading, queue):
        queue.write("\xe4\n")
        assert read(reading, 5) == b"\\xe4\n"


def test_is_full_until_half_of_it_is_read(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("mbtool.cli.view_queue.MAX_WAITING", 100_000)
    with a_pipe() as (reading, queue):
        sizes = 0
        while not queue.is_full:
            sizes += queue.write("x" * 1000)
        assert sizes >= 100_000
        read(reading, sizes)
        assert queue.drain(lambda: False)
        assert not queue.is_full


def test_gives_up_a_reader_that_takes_nothing_once_the_end_is_asked_for() -> None:
    with full_pipe() as (_, writing), open(writing, "w", closefd=False, encoding="ascii") as file:
        queue = ViewQueue(file)
        queue.write("lost\n")
        assert not queue.drain(lambda: True)


def test_the_call_after_a_reader_has_left_raises() -> None:
    with a_pipe() as (reading, queue):
        os.close(reading)
        queue.write("lost\n")
        with pytest.raises(BrokenPipeError):
            queue.drain(lambda: False)
        with pytest.raises(BrokenPipeError):
            queue.write("more\n")


def test_a_file_in_memory_needs_no_queue() -> None:
    file = io.StringIO()
    assert unwaited(file) is file
