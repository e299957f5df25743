"""The text that PassiveModbusMonitor prints."""

from __future__ import annotations

import io
from datetime import UTC, datetime

import pytest

from mbtool.core import (
    Chunk,
    CutError,
    Direction,
    EventKind,
    InputError,
    LineSettings,
    SerialFormat,
    WireEvent,
)
from mbtool.modbus import ascii_adu, rtu_adu
from mbtool.sources.monitor_text import MAX_ROW, is_monitor_text, read_monitor_text

REQUEST = "Read holding register for device ID {} , Start address = {} Quantity = {}"
NOON_NS = int(datetime(2023, 2, 28, 12, 0, tzinfo=UTC).timestamp()) * 1_000_000_000


def _text(*lines: str) -> str:
    """Each line a hundredth of a second after the one before."""
    return "".join(
        f"2023-02-28 12:00:00.{number:02}0000 {line}\n" for number, line in enumerate(lines)
    )


def _read(text: str, line: LineSettings | None = None) -> list[Chunk | WireEvent]:
    return list(read_monitor_text(io.BytesIO(text.encode()), "a.txt", "a", line).pieces)


def _frames(text: str) -> list[tuple[Direction, str]]:
    return [
        (piece.direction, piece.data[:-2].hex(" "))
        for piece in _read(text)
        if isinstance(piece, Chunk)
    ]


def test_a_request_and_its_response_are_made_again() -> None:
    request, response = _read(
        _text(
            REQUEST.format("1f", 258, 2),
            " * Response 1 from device ID 1f , data = 2376",
            " * Response 2 from device ID 1f , data = 65535",
        )
    )
    assert request == Chunk(
        ts_ns=NOON_NS,
        link="a",
        data=rtu_adu(0x1F, bytes.fromhex("03 0102 0002")),
        direction=Direction.REQUEST,
    )
    assert response == Chunk(
        ts_ns=NOON_NS + 20_000_000,
        link="a",
        data=rtu_adu(0x1F, bytes.fromhex("03 04 0948 ffff")),
        direction=Direction.RESPONSE,
    )


@pytest.mark.parametrize(
    ("lines", "request_", "response"),
    [
        (
            [
                "Read coils for device ID  1 , Start address = 0 Quantity = 12",
                " * Response 1 from device ID 1 , data = ff",
                " * Response 2 from device ID 1 , data = 3",
            ],
            "01 01 00 00 00 0c",
            "01 01 02 ff 03",
        ),
        (
            [
                "Read input register for device ID 1 , Start address = 7 Quantity = 2",
                " * Response 1 from device ID 1 , data = 16968",
                " * Response 2 from device ID 1 , data = 0",
                "   * Float: 50.0",
            ],
            "01 04 00 07 00 02",
            "01 04 04 42 48 00 00",
        ),
        (
            [
                "Write single register for device ID 1 , Start address = 7 Quantity = 9",
                " * Response from device ID 1  Address 7 is now 9",
            ],
            "01 06 00 07 00 09",
            "01 06 00 07 00 09",
        ),
        (
            [REQUEST.format(1, 7, 1), " * Illegal Data Address exception"],
            "01 03 00 07 00 01",
            "01 83 02",
        ),
        ([REQUEST.format(1, 7, 1), " * Exception! Code: b"], "01 03 00 07 00 01", "01 83 0b"),
    ],
)
def test_every_kind_of_line_is_understood(lines: list[str], request_: str, response: str) -> None:
    assert _frames(_text(*lines)) == [
        (Direction.REQUEST, request_),
        (Direction.RESPONSE, response),
    ]


def test_a_request_without_a_response_is_followed_by_the_next() -> None:
    found = _frames(_text(REQUEST.format(1, 1, 1), REQUEST.format(2, 1, 1)))
    assert [direction for direction, _ in found] == [Direction.REQUEST] * 2


def test_a_response_that_another_line_cuts_off_is_given_as_it_is() -> None:
    found = _frames(
        _text(
            REQUEST.format(1, 1, 2),
            " * Response 1 from device ID 1 , data = 5",
            REQUEST.format(1, 1, 1),
        )
    )
    assert found[1] == (Direction.RESPONSE, "01 03 02 00 05")


@pytest.mark.parametrize(
    "line",
    [
        "Write multiple registers for device ID  1 , Start address = 0 Quantity = 1",
        " * Write command 0 : 12",
        " * Response 1 from device ID 1 , data = 5",
        " * Response 2 from device ID 1 , data = 5",
        " * Illegal Data Address exception",
        "Read holding register for device ID 1 , Start address = 70000 Quantity = 1",
        "something else",
    ],
)
def test_a_line_that_is_not_understood_is_told(line: str) -> None:
    (event,) = _read(_text(line))
    assert isinstance(event, WireEvent)
    assert (event.kind, event.link) == (EventKind.UNREADABLE, "a")
    assert event.message == f"a line that is not understood: {line.strip()}"


@pytest.mark.parametrize("data", ["70000", "ff"])
def test_a_value_that_no_register_has_is_told(data: str) -> None:
    request, event = _read(
        _text(REQUEST.format(1, 1, 1), f" * Response 1 from device ID 1 , data = {data}")
    )
    assert isinstance(request, Chunk)
    assert isinstance(event, WireEvent)


def test_a_time_that_cannot_be_is_told() -> None:
    (event,) = _read("2023-02-30 12:00:00 Read coils\n")
    assert isinstance(event, WireEvent)


@pytest.mark.parametrize(
    "text",
    [
        _text(REQUEST.format(1, 1, 2), " * Response 1 from device ID 1 , data = 5"),
        _text(REQUEST.format(1, 1, 1)) + "2023-02-28 12:0",
    ],
)
def test_a_file_that_ends_in_a_response_is_cut(text: str) -> None:
    pieces: list[Chunk | WireEvent] = []
    with pytest.raises(CutError, match=r"^a\.txt: ends in the middle of a response, in row 2$"):
        pieces.extend(read_monitor_text(io.BytesIO(text.encode()), "a.txt", "a", None).pieces)
    assert len(pieces) == 1


def test_a_row_has_a_bound() -> None:
    with pytest.raises(InputError, match=r"^a\.txt: row 1: more than 1024 characters$"):
        _read("2023-02-28 12:00:00 " + "x" * MAX_ROW)


def test_on_an_ascii_line_the_frames_are_ascii() -> None:
    line = LineSettings(SerialFormat(9600, 7), ascii=True)
    (request,) = _read(_text(REQUEST.format(1, 1, 1)), line)
    assert isinstance(request, Chunk)
    assert request.data == ascii_adu(1, bytes.fromhex("03 0001 0001"))


@pytest.mark.parametrize(
    ("head", "is_of_this_kind"),
    [
        (_text(REQUEST.format(1, 258, 16)).encode()[:64], True),
        (_text(" * Response 4 from device ID 1 , data = 0").encode()[:64], True),
        (b"2023-02-28 12:00:00 Write single coil for", True),
        (b"2023-02-28 12:00:00 started", False),
        (b"\x01\x03", False),
    ],
)
def test_the_first_line_shows_the_kind(head: bytes, is_of_this_kind: bool) -> None:
    assert is_monitor_text(head) is is_of_this_kind
