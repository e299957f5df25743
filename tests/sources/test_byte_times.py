"""Byte times of a logic analyser, as CSV."""

from __future__ import annotations

import io
from itertools import pairwise
from typing import TYPE_CHECKING

import pytest

from mbtool.core import Chunk, CutError, InputError, LineSettings, SerialFormat, WireEvent
from mbtool.sources.byte_times import LOOKED_AT, MAX_ROW, is_byte_times, read_byte_times

if TYPE_CHECKING:
    from collections.abc import Callable

HEADER = "t_start_s,t_end_s,line,byte_hex\n"
FRAME = bytes.fromhex("01 03 0063 0001 7414")  # unit 1, read holding register 99, CRC


def _rows(
    data: bytes, baud: int, bits: int = 11, width_bits: float = 8, start_s: float = 0.5
) -> str:
    """Bytes back to back; an analyser's decoder gives the width of the data bits."""
    return "".join(
        f"{start_s + at * bits / baud:.7f},{start_s + (at * bits + width_bits) / baud:.7f},"
        f"rx,{byte:02x}\n"
        for at, byte in enumerate(data)
    )


def _read(text: str, line: LineSettings | None = None) -> tuple[SerialFormat, list[Chunk]]:
    settings, pieces = read_byte_times(io.BytesIO(text.encode()), "a.csv", "a", line)
    return settings.format, list(pieces)


def test_each_byte_has_the_time_when_its_last_bit_arrived() -> None:
    _, chunks = _read(HEADER + _rows(FRAME, 19200))
    assert b"".join(chunk.data for chunk in chunks) == FRAME
    character_ns = SerialFormat(19200).character_ns
    for number, chunk in enumerate(chunks, 1):
        assert chunk.link == "a"
        assert chunk.ts_ns == pytest.approx(500_000_000 + number * character_ns, abs=200)


@pytest.mark.parametrize("baud", [1200, 9600, 19200, 38400, 115200])
@pytest.mark.parametrize(
    ("bits", "width_bits", "settings"),
    [(11, 8, "8E1"), (10, 8, "8N1"), (11, 11, "8E1"), (10, 10, "8N1"), (11.4, 8, "8E1")],
)
def test_the_bytes_show_the_baud_rate_and_the_length_of_a_character(
    baud: int, bits: int, width_bits: float, settings: str
) -> None:
    found, _ = _read(HEADER + _rows(FRAME, baud, bits, width_bits))
    assert str(found) == f"{baud}-{settings}"


@pytest.mark.parametrize("rows", ["", "0.1,0.1,rx,01\n", "0.1,0.2,rx,01\n"])
def test_without_a_usual_baud_rate_it_is_the_standards(rows: str) -> None:
    assert _read(HEADER + rows)[0] == SerialFormat()


def test_what_the_user_says_of_the_line_counts() -> None:
    line = LineSettings(SerialFormat(9600, 7), ascii=True)
    settings, _ = read_byte_times(
        io.BytesIO((HEADER + _rows(FRAME, 19200)).encode()), "a.csv", "a", line
    )
    assert settings is line


def test_columns_stand_in_any_order_and_others_are_left_alone() -> None:
    text = "byte_hex,note,t_end_s,t_start_s\r\n0x2a,hm,1700000000.000000250,1.7e9\r\n\r\n"
    _, (chunk,) = _read(text)
    assert chunk.data == b"*"
    assert chunk.ts_ns == 1_700_000_000_000_000_000 + SerialFormat().character_ns


@pytest.mark.parametrize("start_s", [-0.48, -0.002, -7200.0])
def test_times_below_0_keep_their_order_and_their_distances(start_s: float) -> None:
    # The trigger is between the bytes, or behind them.
    found, chunks = _read(HEADER + _rows(FRAME, 9600, start_s=start_s))
    expected_format, expected = _read(HEADER + _rows(FRAME, 9600, start_s=0))
    assert found == expected_format
    assert [chunk.data for chunk in chunks] == [chunk.data for chunk in expected]
    for chunk, same in zip(chunks, expected, strict=True):
        assert chunk.ts_ns == pytest.approx(same.ts_ns, abs=200)  # Times are written to 100 ns.


def test_a_trigger_at_a_later_row_moves_no_byte_against_another() -> None:
    _, chunks = _read(HEADER + "-0.25,-0.249,rx,01\n0,0.001,rx,02\n1.5,1.501,rx,03\n")
    first, *others = (chunk.ts_ns for chunk in chunks)
    assert first == 10**9 // 1000
    assert [ts_ns - first for ts_ns in others] == [250_000_000, 1_750_000_000]


def test_more_rows_than_are_looked_at_come_out_in_order() -> None:
    data = bytes(number % 251 for number in range(3 * LOOKED_AT))
    _, chunks = _read(HEADER + _rows(data, 9600))
    assert b"".join(chunk.data for chunk in chunks) == data
    assert all(one.ts_ns < other.ts_ns for one, other in pairwise(chunks))


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("t_start_s,t_end_s,line,what\n", "row 1: there is no column byte_hex"),
        ("byte_hex,t_end_s\n01,0\n", "row 1: there is no column t_start_s"),
        (HEADER + "0.1,0.2,rx,01\n0.3,0.4,rx\n0.5", "row 3: 3 columns, where row 1 has 4"),
        (HEADER + "0.1,soon,rx,01\n", "row 2: t_end_s is 'soon'; a number of seconds"),
        (HEADER + "-1e10,0,rx,01\n", "row 2: t_start_s is '-1e10'; a number of seconds"),
        (
            HEADER + "0.1,0.2,rx,01\n-1,0,rx,02\n",
            "row 3: t_start_s is '-1', before that of the first row",
        ),
        (
            HEADER + "-1,-0.9,rx,01\n-1.1,0,rx,02\n",
            "row 3: t_start_s is '-1.1', before that of the first row",
        ),
        (HEADER + "nan,0,rx,01\n", "row 2: t_start_s is 'nan'; a number of seconds"),
        (HEADER + "1e999999999,0,rx,01\n", "row 2: t_start_s is '1e999999999'; a number"),
        (HEADER + "0.2,0.1,rx,01\n", "row 2: t_end_s is before t_start_s"),
        (HEADER + "0.1,0.2,rx,1ff\n", "row 2: byte_hex is '1ff'; 00 to ff would be right"),
        (HEADER + "0.1,0.2,rx,\n", "row 2: byte_hex is ''; 00 to ff would be right"),
        (HEADER + "0" * (MAX_ROW + 1), f"row 2: more than {MAX_ROW} characters"),
    ],
)
def test_a_wrong_row_is_one_line_with_its_number(text: str, problem: str) -> None:
    with pytest.raises(InputError) as caught:
        _read(text)
    assert str(caught.value).startswith(f"a.csv: {problem}")
    assert "\n" not in str(caught.value)
    assert not isinstance(caught.value, CutError)


@pytest.mark.parametrize("wrong", [3, LOOKED_AT + 3])
def test_what_comes_before_a_wrong_row_is_given(wrong: int) -> None:
    rows = _rows(bytes(wrong), 9600)
    pieces: list[Chunk | WireEvent] = []
    with pytest.raises(InputError, match=rf"^a\.csv: row {wrong + 2}: "):
        pieces.extend(
            read_byte_times(io.BytesIO(f"{HEADER}{rows}?\n".encode()), "a.csv", "a", None).pieces
        )
    assert len(pieces) == wrong


def test_every_beginning_of_a_file_gives_its_whole_rows_and_is_cut() -> None:
    whole = HEADER + _rows(FRAME, 9600)
    for end in range(len(HEADER), len(whole)):
        last = whole[:end].rpartition("\n")[2]
        pieces: list[Chunk | WireEvent] = []
        given = read_byte_times(io.BytesIO(whole[:end].encode()), "a.csv", "a", None).pieces
        if not last or last.endswith(f"rx,{FRAME[whole[:end].count(chr(10)) - 1]:02x}"):
            pieces.extend(given)
        else:
            with pytest.raises(CutError, match=r"^a\.csv: ends in the middle of row \d+$"):
                pieces.extend(given)
        chunks = [piece for piece in pieces if isinstance(piece, Chunk)]
        assert b"".join(chunk.data for chunk in chunks) == FRAME[: len(chunks)]
        assert len(chunks) >= whole[:end].count("\n") - 1


@pytest.mark.parametrize(
    ("head", "is_of_this_kind"),
    [
        (HEADER.encode(), True),
        (b"byte_hex,t_start_s,t_end_s\r\n", True),
        (b"t_start_s,t_end_s,line,byte_he", True),
        (b"time,t_end\nt_start_s,", False),
        (b'name,type,start_time,duration,data\n"Async Serial","data",0.1,0.001,0x01\n', True),
        (b"Time [s],Value,Parity Error,Framing Error\n0.1,1,,\n", True),
        (b"Time [s],Value,Parity Error,Framing Error\n0.1,01 03 00 6B,,\n", False),
        (b"time,value\n0.1,0x01\n", True),
        (b"time,value\n0.1,23\n", False),
        (b"time,value\nsoon,0x01\n", False),
        (b"\x01\x03", False),
    ],
)
def test_the_header_shows_the_kind(head: bytes, is_of_this_kind: bool) -> None:
    assert is_byte_times(head) is is_of_this_kind


def _logic_2(data: bytes, baud: int, bits: int) -> str:
    rows = "".join(
        f'"Async Serial","data",{0.5 + at * bits / baud:.10f},{bits / baud:.10f},0x{byte:02X},\n'
        for at, byte in enumerate(data)
    )
    return "name,type,start_time,duration,data,error\n" + rows


def _logic_2_by_date(data: bytes, baud: int, bits: int) -> str:
    rows = "".join(
        f'"Async Serial","data",2026-11-22T09:14:03.{500_000_000 + round(at * bits / baud * 1e9)}'
        f"+00:00,{bits / baud:.10f},0x{byte:02X},\n"
        for at, byte in enumerate(data)
    )
    return "name,type,start_time,duration,data,error\n" + rows


def _logic_1(data: bytes, baud: int, bits: int) -> str:
    return "Time [s],Value,Parity Error,Framing Error\n" + "".join(
        f"{0.5 + at * bits / baud:.15f},0x{byte:02X},,\n" for at, byte in enumerate(data)
    )


@pytest.mark.parametrize("form", [_logic_2, _logic_2_by_date, _logic_1])
@pytest.mark.parametrize("baud", [1200, 9600, 19200, 115200])
@pytest.mark.parametrize(("bits", "settings"), [(11, "8E1"), (10, "8N1")])
def test_the_exports_of_saleae_are_read_as_they_are(
    form: Callable[[bytes, int, int], str], baud: int, bits: int, settings: str
) -> None:
    found, chunks = _read(form(FRAME, baud, bits))
    assert str(found) == f"{baud}-{settings}"
    assert b"".join(chunk.data for chunk in chunks) == FRAME
    begin_ns = 1_795_338_843_000_000_000 if form is _logic_2_by_date else 0
    for number, chunk in enumerate(chunks, 1):
        end_ns = begin_ns + 500_000_000 + number * found.character_ns
        assert chunk.ts_ns == pytest.approx(end_ns, abs=1000)


@pytest.mark.parametrize(
    ("cells", "data"),
    [
        (["0x01", "0x03", "0xFF"], b"\x01\x03\xff"),
        (["0b0000 0001", "0b0000 0011", "0b11111111"], b"\x01\x03\xff"),
        (["1", "3", "255"], b"\x01\x03\xff"),
        (["'A' (0x41)", "'1' (0x01)"], b"A\x01"),
        ([":", "0", "1", "\\r", "\\n"], b":01\r\n"),
        (["':'", "'0'", "COMMA", "' '"], b":0, "),
    ],
)
def test_a_byte_is_read_as_the_analyser_displays_it(cells: list[str], data: bytes) -> None:
    text = "Time [s],Value\n" + "".join(f"{at / 100},{one}\n" for at, one in enumerate(cells))
    _, chunks = _read(text)
    assert b"".join(chunk.data for chunk in chunks) == data


def test_rows_of_an_analyser_that_are_no_data_are_passed_over() -> None:
    text = _logic_2(FRAME, 9600, 10)
    heading, first, *rest = text.splitlines(keepends=True)
    _, chunks = _read(heading + first.replace('"data"', '"start"') + "".join(rest))
    assert b"".join(chunk.data for chunk in chunks) == FRAME[1:]
