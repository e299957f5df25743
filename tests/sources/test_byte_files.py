"""Bytes of a line without times: raw, and as hexadecimal."""

from __future__ import annotations

import io
import tracemalloc

import pytest
from hypothesis import given
from hypothesis import strategies as st

from mbtool.core import Chunk, CutError, InputError, LineSettings, SerialFormat, Stamp, WireEvent
from mbtool.sources.byte_files import READ_BYTES, SerialBytes, read_hex, read_raw

LINE = LineSettings(SerialFormat(9600))
BYTES = bytes.fromhex("01 03 0180 000a c5d9")


def _bytes(of_file: SerialBytes) -> bytes:
    return b"".join(piece.data for piece in of_file.pieces)


def _hex(text: bytes) -> bytes:
    return _bytes(read_hex(io.BytesIO(text), "a.txt", "a", LINE))


@given(st.binary(max_size=3 * READ_BYTES))
def test_a_raw_file_gives_its_bytes_in_order_without_times(data: bytes) -> None:
    line, pieces = read_raw(io.BytesIO(data), "a.bin", "a", LINE)
    assert line is LINE
    count = 0
    for piece in pieces:
        assert piece.data == data[count : count + len(piece.data)]
        assert (piece.link, piece.stamp) == ("a", Stamp.UNKNOWN)
        count += len(piece.data)
        # As if they had come back to back from 1970 on.
        assert piece.ts_ns == count * LINE.format.character_ns
    assert count == len(data)


@pytest.mark.parametrize(
    "text",
    [
        b"01 03 01 80 00 0a c5 d9",
        b"01 03 01 80\n00 0A C5 D9\n",
        b"01 03 01 80\r\n\r\n00 0A C5 D9\r\n",
        b"010301 80000ac5d9",
        b"0x01 0x03 0X01 0x80 0x00 0x0a 0xc5 0xd9",
        b"0x01, 0x03, 0x01, 0x80,\n0x00, 0x0a, 0xc5, 0xd9,\n",
        b"# a line of 2024\n01 03 01 80 # the rest: 00\n\t00 0a c5 d9",
        b"0103018000\n0ac5d9#",
    ],
)
def test_hexadecimal_is_read_as_people_write_it(text: bytes) -> None:
    assert _hex(text) == BYTES


@given(st.binary(max_size=2 * READ_BYTES), st.sampled_from((b"", b" ", b"\n", b" 0x")))
def test_rows_of_any_length_are_read(data: bytes, before: bytes) -> None:
    assert _hex(b"".join(before + b"%02x" % byte for byte in data)) == data


def test_a_comment_may_be_longer_than_what_is_held() -> None:
    assert _hex(b"01#" + b" ff" * READ_BYTES + b"\n03") == b"\x01\x03"


@pytest.mark.parametrize(
    ("text", "row", "word"),
    [
        (b"01 03\n01 8\n00 0a\n", 2, "8"),
        (b"01 03 zz 80", 1, "zz"),
        (b"01\n02\n\n# no\n0x1 02", 5, "0x1"),
        (b"00000000: 0103 0180", 1, "00000000:"),
        (b"01 \xff\xfe 03", 1, "\\ufffd\\ufffd"),
        (b"01 03\n" + b"x" * 5000, 2, "x" * 20),
    ],
)
def test_what_is_no_pair_of_digits_is_one_line_with_its_row(
    text: bytes, row: int, word: str
) -> None:
    with pytest.raises(InputError) as caught:
        _hex(text)
    assert str(caught.value) == (
        f"a.txt: row {row}: '{word}' is not made of pairs of hexadecimal digits, "
        "as in 01 03 00 6B or 0103006B"
    )
    assert not isinstance(caught.value, CutError)


@pytest.mark.parametrize("end", [b"\n01 0", b" 01 0x", b" 010", b" 0x010"])
def test_a_file_that_ends_in_a_byte_is_cut_behind_all_before(end: bytes) -> None:
    pieces: list[Chunk | WireEvent] = []
    with pytest.raises(CutError, match=r"^a\.txt: ends in the middle of a byte, in row [12]$"):
        pieces.extend(read_hex(io.BytesIO(b"ff" + end), "a.txt", "a", LINE).pieces)
    data = b"".join(piece.data for piece in pieces if isinstance(piece, Chunk))
    assert b"\xff\x01".startswith(data)
    assert data


def test_a_row_without_end_is_not_held() -> None:
    class Endless(io.BytesIO):
        def readline(self, size: int | None = -1, /) -> bytes:
            return b"010" * (READ_BYTES // 3)  # An odd number of digits each time.

    stream = Endless()
    pieces = read_hex(stream, "a.txt", "a", LINE).pieces
    tracemalloc.start()
    try:
        for _ in range(1_000):
            next(pieces)
        assert tracemalloc.get_traced_memory()[1] < 1 << 20
    finally:
        tracemalloc.stop()
