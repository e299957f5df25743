"""Marks of damaged bytes, and bytes that look like marks."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from mbtool.ports.line_errors import Unmarker


def unmarked(*reads: bytes) -> tuple[bytes, list[int]]:
    unmarker = Unmarker()
    heard, damaged = bytearray(), []
    for read in reads:
        piece, places = unmarker.feed(read)
        damaged += [len(heard) + place for place in places]
        heard += piece
    heard += unmarker.flush()
    return bytes(heard), damaged


def marked(data: bytes, damaged: set[int]) -> bytes:
    """What a driver would give."""
    out = bytearray()
    for at, byte in enumerate(data):
        out += b"\xff\x00" if at in damaged else b"\xff" if byte == 0xFF else b""
        out.append(byte)
    return bytes(out)


@pytest.mark.parametrize(
    ("read", "heard", "damaged"),
    [
        ("01 03 00 6b", "01 03 00 6b", []),
        ("ff ff", "ff", []),
        ("00 ff ff 00", "00 ff 00", []),
        ("ff 00 f8", "f8", [0]),
        ("01 ff 00 00 02", "01 00 02", [1]),
        ("ff 00 ff", "ff", [0]),
        ("ff ff ff 00 41 ff ff", "ff 41 ff", [1]),
        ("ff 41", "ff 41", []),  # Which no driver writes.
        ("ff", "ff", []),
        ("ff 00", "ff 00", []),
    ],
)
def test_a_read_gives_the_bytes_and_the_damaged_ones(
    read: str, heard: str, damaged: list[int]
) -> None:
    assert unmarked(bytes.fromhex(read)) == (bytes.fromhex(heard), damaged)


def test_bytes_without_marks_are_not_copied() -> None:
    data = bytes(range(255))
    assert Unmarker().feed(data)[0] is data


@given(st.binary(max_size=50), st.data())
def test_every_byte_comes_back_however_the_reads_are_cut(data: bytes, draw: st.DataObject) -> None:
    damaged = draw.draw(st.sets(st.integers(0, max(len(data) - 1, 0)))) if data else set()
    whole = marked(data, damaged)
    cuts = sorted(draw.draw(st.sets(st.integers(0, len(whole)))))
    reads = [whole[a:b] for a, b in zip([0, *cuts], [*cuts, len(whole)], strict=True)]
    assert unmarked(*reads) == (data, sorted(damaged))


@given(st.lists(st.binary(max_size=20)))
def test_whatever_comes_at_most_two_bytes_are_held(reads: list[bytes]) -> None:
    unmarker = Unmarker()
    for read in reads:
        unmarker.feed(read)
        assert len(unmarker._held) <= 2
