"""How many offsets the search looks at, for each 1000 bytes: the price of a line, not timed.

Ordinary polling needs no search at all. A search of each frame of 8 bytes would be 125 offsets.
"""

from __future__ import annotations

import random
from typing import TYPE_CHECKING

import pytest

from mbtool.core import SerialFormat
from mbtool.modbus.adu import Adu, rtu_adu
from mbtool.serial_line import RtuSplitter
from mbtool.serial_line.search import PathSearch

if TYPE_CHECKING:
    from collections.abc import Callable

FORMAT = SerialFormat(9600, 8, "E", 1)
SIZE = 20_000
READ_SIZE = 1024
NOISE = random.Random(29).randbytes(SIZE)


def write(value: int, unit: int = 1, function: int = 6) -> bytes:
    return rtu_adu(unit, bytes((function, 0, 1)) + value.to_bytes(2))


def poll(number: int) -> tuple[bytes, bytes]:
    data = NOISE[number * 16 : number * 16 + 16]
    return rtu_adu(1, bytes.fromhex("03 0000 0008")), rtu_adu(1, b"\x03\x10" + data)


LINES: dict[str, tuple[Callable[[int], bytes], int]] = {
    "polling": (lambda at: b"".join(poll(at % 1000)), 0),
    "one write and its echo": (lambda _: write(3), 10),
    "loopback test in a loop": (lambda _: rtu_adu(1, bytes.fromhex("08 0000 A537")), 10),
    "set points and their echoes": (lambda at: 2 * write(at), 5),
    "set points to two units": (lambda at: 2 * write(at, 1 + at % 2), 5),
    "scan of units": (lambda at: rtu_adu(1 + at % 247, bytes.fromhex("03 0000 0001")), 5),
    "loopback test of all units": (
        lambda at: rtu_adu(1 + at % 247, bytes.fromhex("08 0000 A537")), 20,
    ),
    "a byte of noise behind each frame": (
        lambda at: b"\xff".join((*poll(at % 1000), b"")), 5,
    ),
    "nothing but zeros": (lambda _: bytes(64), 150),
    "random bytes": (lambda at: NOISE[at * 100 : at * 100 + 100], 150),
}  # fmt: skip


@pytest.mark.parametrize("name", LINES)
def test_search_looks_at_few_offsets(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    make, most = LINES[name]
    sent, number = b"", 0
    while len(sent) < SIZE:
        sent, number = sent + make(number), number + 1
    looked_at: list[int] = []
    extend = PathSearch._extend

    def counted(search: PathSearch, offset: int, paths: list[object]) -> None:
        looked_at.append(offset)
        extend(search, offset, paths)  # type: ignore[arg-type]

    monkeypatch.setattr(PathSearch, "_extend", counted)
    splitter, told = RtuSplitter(FORMAT, timed=False), b""
    for at in range(0, len(sent), READ_SIZE):
        read = sent[at : at + READ_SIZE]
        told += b"".join(one.raw for one in splitter.feed(read, at * FORMAT.character_ns + 1))
    told += b"".join(one.raw for one in splitter.close())
    assert told == sent
    assert 1000 * len(looked_at) / len(sent) <= most


def test_equal_writes_are_pairs_whose_last_one_decides() -> None:
    """A loop of 61 equal frames before a poll: one lacks its echo, so the last are in doubt."""
    loop = [write(3)] * 400
    splitter = RtuSplitter(FORMAT, timed=False)
    request, response = poll(0)
    for count, doubt in ((60, False), (61, True)):
        splitter = RtuSplitter(FORMAT, timed=False)
        sent = request + response + b"".join(loop) + request + response
        sent += b"".join(loop[:count]) + request + response
        frames = [
            one for one in (*splitter.feed(sent, 1), *splitter.close()) if isinstance(one, Adu)
        ]
        assert b"".join(one.raw for one in frames) == sent
        behind = frames[404 : 404 + count]
        assert any(one.confidence < 0.8 for one in behind) is doubt
