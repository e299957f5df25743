"""Modbus frames in the logs of other programs."""

from __future__ import annotations

from random import Random
from typing import TYPE_CHECKING

import pytest

from mbtool.core import InputError, WireEvent
from mbtool.modbus import rtu_adu
from mbtool.sources.files import open_capture
from mbtool.sources.text_frames import Label, TextFrames, whole_frames
from mbtool.sources.text_log import MAY_BE_BYTES, SHAPE, may_be_bytes
from mbtool.sources.text_marks import DateOrder, find_time, iso_ns
from mbtool.workflows.shared.reading import Reading, ReadingOptions
from tests.sources.text_logs import BY_WORD, FORMS, TIMED, conversation, expected

if TYPE_CHECKING:
    from pathlib import Path

    from mbtool.devices import NamedTransaction


def _read(path: Path) -> list[NamedTransaction]:
    reading = Reading([str(path)], ReadingOptions())
    return [one for one in reading.records() if not isinstance(one, WireEvent)]


def _told(records: list[NamedTransaction]) -> list[tuple[int, str]]:
    by_time = sorted(records, key=lambda one: one.start_ns)
    return [(one.function, str(one.outcome)) for one in by_time]


@pytest.mark.parametrize("transport", ["rtu", "tcp"])
@pytest.mark.parametrize("form", sorted(BY_WORD))
def test_each_form_gives_the_conversation(tmp_path: Path, form: str, transport: str) -> None:
    path = tmp_path / "log.txt"
    path.write_text(FORMS[form](conversation(transport)))
    told = _told(_read(path))
    if transport == "tcp" and form not in TIMED:
        # Requests on TCP may overtake each other, so without times the response may come later.
        told = [
            (function, outcome.replace("not-captured", "no-answer")) for function, outcome in told
        ]
    assert told == expected()


@pytest.mark.parametrize("form", sorted(set(FORMS) - BY_WORD))
def test_a_stream_of_rtu_needs_no_word(tmp_path: Path, form: str) -> None:
    path = tmp_path / "log.txt"
    path.write_text(FORMS[form](conversation()))
    assert _told(_read(path)) == expected()


def test_a_frame_that_is_shown_as_rtu_and_with_an_mbap_header_counts_once(tmp_path: Path) -> None:
    path = tmp_path / "log.txt"
    both = zip(conversation("rtu"), conversation("tcp"), strict=True)
    path.write_text(
        "\n".join(
            f"{'send' if rtu.is_request else 'parsed'} {{\n  data: <Buffer {rtu.data.hex(' ')}>,\n"
            f"  buffer: <Buffer {tcp.data.hex(' ')}>\n}}"
            for rtu, tcp in both
        )
    )
    found = _read(path)
    assert {str(one.transport) for one in found} == {"tcp"}
    assert [(one.function, str(one.outcome).replace("not-captured", "no-answer"))
            for one in sorted(found, key=lambda one: one.start_ns)] == expected()  # fmt: skip


def test_responses_alone_count_if_their_transaction_ids_are_in_a_row(tmp_path: Path) -> None:
    path = tmp_path / "log.txt"
    lines = [one.data.hex(" ") for one in conversation("tcp") if not one.is_request]
    path.write_text("\n".join(f"Processing: {line}" for line in lines))
    assert _told(_read(path)) == [
        (one[0], "not-captured") for one in expected() if one[1] != "no-answer"
    ]


@pytest.mark.parametrize("transport", ["rtu", "tcp"])
def test_a_response_may_be_read_byte_by_byte_behind_other_files(
    tmp_path: Path, transport: str
) -> None:
    path = tmp_path / "log.txt"
    lines = ['read(3, "\\177ELF\\2\\1\\1\\3\\0\\0\\0"..., 832) = 832']
    for one in conversation(transport):
        if one.is_request:
            lines.append(f'sendto(3, "{_escaped(one.data)}", {len(one.data)}, 0, NULL, 0) = 12')
        else:
            pieces = one.data[:6], *(one.data[at : at + 1] for at in range(6, len(one.data)))
            lines += [f'recvfrom(3, "{_escaped(each)}", 9, 0, NULL, NULL) = 1' for each in pieces]
    path.write_text("\n".join(lines))
    told = [(one[0], one[1].replace("not-captured", "no-answer")) for one in _told(_read(path))]
    assert told == expected()


def _escaped(data: bytes) -> str:
    return "".join(
        chr(byte) if 32 <= byte < 127 and chr(byte) not in '"\\' else f"\\{byte:03o}"
        for byte in data
    )


def test_digits_of_times_in_several_lines_are_no_frame_although_their_crc_fits() -> None:
    digits = bytes.fromhex("179583439617958343981795834400")
    assert whole_frames(digits) == ()
    frames = TextFrames()
    said = conversation()
    for one in said[:2]:
        frames.feed([one.data], Label(b"x", None), None, 1)
    assert frames.is_modbus
    for row, piece in enumerate((digits[:5], digits[5:10], digits[10:]), 2):
        assert frames.feed([piece], Label(b"end", None), None, row) == []


def test_equal_checksums_that_look_like_an_echo_are_no_transaction(tmp_path: Path) -> None:
    path = tmp_path / "sums.txt"
    # An RTU frame of function 08 by its CRC, as one of 65,536 checksums is; the paths have words.
    name = rtu_adu(22, bytes.fromhex("089b65f5cda3fa5bf751a2bbc3")).hex()
    other = "00112233445566778899aabbccddeeff"
    path.write_text(f"{other}  usr/lib/send.py\n{name}  usr/lib/send\n{name}  usr/share/reply\n")
    with pytest.raises(InputError):
        _read(path)


def test_requests_and_responses_need_no_frame_if_they_fit_each_other(tmp_path: Path) -> None:
    path = tmp_path / "log.txt"
    lines = [
        f"{one.time:%H:%M:%S}.{one.time.microsecond // 1000:03d} conn: "
        f"{'request' if one.is_request else 'response'}: "
        + "".join(f"[{byte:02x}]" for byte in one.data[:-2])
        for one in conversation()
    ]
    path.write_text("\n".join(lines))
    found = _read(path)
    assert _told(found) == [one for one in expected() if one[1] != "no-answer"]
    assert {one.latency_ns for one in found} == {57_000_000}
    path.write_text("\n".join(line for line in lines if "request" in line))
    with pytest.raises(InputError):
        _read(path)


@pytest.mark.parametrize("form", sorted(TIMED))
def test_latency_is_the_time_between_two_lines(tmp_path: Path, form: str) -> None:
    path = tmp_path / "log.txt"
    path.write_text(FORMS[form](conversation()))
    latencies = {one.latency_ns for one in _read(path) if one.latency_ns is not None}
    in_seconds = form in ("esphome", "go_client", "gateway", "syslog", "powershell", "dotted")
    assert latencies == {0 if in_seconds else 57_000_000}


@pytest.mark.parametrize("form", sorted(set(FORMS) - TIMED))
def test_without_times_there_is_no_latency(tmp_path: Path, form: str) -> None:
    path = tmp_path / "log.txt"
    path.write_text(FORMS[form](conversation()))
    assert {one.latency_ns for one in _read(path)} == {None}


def test_lines_that_come_again_give_the_same_frames_again(tmp_path: Path) -> None:
    path = tmp_path / "log.txt"
    request, response = (
        rtu_adu(1, bytes.fromhex("030000000a")),
        rtu_adu(1, b"\x03\x14" + b"\0\1" * 10),
    )
    lines = (b"\xff" * 4, request + response[:10], response[10:])
    path.write_text("".join(f"RX: {line.hex(' ')}\n" for line in lines) * 2)
    assert _told(_read(path)) == [(3, "ok"), (3, "ok")]


def test_equal_responses_of_a_log_without_requests_all_count(tmp_path: Path) -> None:
    path = tmp_path / "log.txt"
    response = rtu_adu(1, b"\x03\x14" + b"\0\1" * 10).hex(" ")
    path.write_text("".join(f"12:00:{second:02} RX: {response}\n" for second in range(50)))
    found = _read(path)
    assert _told(found) == [(3, "not-captured")] * 50
    assert [one.start_ns % (60 * 10**9) for one in found] == [one * 10**9 for one in range(50)]


def _starts(path: Path, heads: list[str], begin: str = "1970-01-01 00:00:00") -> list[float]:
    """The seconds since `begin` of the times of requests that a log shows, each behind a text."""
    requests = [rtu_adu(1, bytes((6, 0, 1, 0, number))) for number in range(len(heads))]
    path.write_text(
        "".join(f"{head} TX: {one.hex(' ')}\n" for head, one in zip(heads, requests, strict=True))
    )
    by_value = sorted(_read(path), key=lambda one: one.request_values or [])
    return [(one.start_ns - iso_ns(begin.encode())) / 1e9 for one in by_value]


def test_lines_a_little_out_of_order_at_midnight_add_no_day(tmp_path: Path) -> None:
    heads = ["23:59:59.998", "00:00:00.001", "23:59:59.999", "00:00:00.010", "23:50:00.000",
             "00:10:00.000"]  # fmt: skip
    day = 86_400
    assert _starts(tmp_path / "log.txt", heads) == [
        day - 0.002, day + 0.001, day + 0.001, day + 0.01, 2 * day - 600, 2 * day + 600,
    ]  # fmt: skip


def test_frames_before_the_first_time_have_that_time(tmp_path: Path) -> None:
    heads = ["first", "next", "12:00:00.5", "more", "12:00:02"]
    noon = 12 * 3600
    assert _starts(tmp_path / "log.txt", heads) == [
        noon + 0.5, noon + 0.5, noon + 0.5, noon + 0.5, noon + 2,
    ]  # fmt: skip


def test_a_port_before_a_time_is_no_month_and_a_number_in_brackets_no_time(tmp_path: Path) -> None:
    noon = 12 * 3600
    heads = ["COM 3 12:00:00.1", "COM 3 12:00:01.1"]
    assert _starts(tmp_path / "log.txt", heads) == [noon + 0.1, noon + 1.1]
    time = find_time(b"[2] TX: 01 03")
    assert time is None
    assert find_time(b"[2345] TX: 01 03") is not None


@pytest.mark.parametrize(
    ("dates", "days"),
    [
        (["12/02/2024", "13/02/2024"], [42, 43]),
        (["02/12/2024", "02/13/2024"], [42, 43]),
        (["13/01/2024", "01/02/2024"], [12, 31]),
        (["01/13/2024", "02/01/2024"], [12, 31]),
        (["12.02.2024", "13.02.2024"], [42, 43]),
    ],
)
def test_day_and_month_have_one_order_in_a_file(
    tmp_path: Path, dates: list[str], days: list[int]
) -> None:
    heads = [f"{date} 00:00:00" for date in dates]
    found = _starts(tmp_path / "log.txt", heads, "2024-01-01 00:00:00")
    assert found == [one * 86_400 for one in days]


def test_a_date_in_the_other_order_is_no_time() -> None:
    order = DateOrder()
    texts = (b"13/02/2024 12:00:00", b"12/02/2024 12:00:00", b"02/13/2024 12:00:00")
    (first, time), (second, _), (third, _) = [(one, find_time(one)) for one in texts]
    assert time is not None
    assert order.read(time, first) - order.read(time, second) == 86_400 * 10**9
    with pytest.raises(ValueError, match="no month"):
        order.read(time, third)


@pytest.mark.parametrize(
    ("numbers", "starts"),
    [
        (["1705752000", "1705752001"], [0, 1]),
        (["[1705752000]", "[1705752001]"], [0, 1]),
        (["1705752000.25", "1705752001.5"], [0.25, 1.5]),
        (["(1705752000.250000)", "(1705752001.500000)"], [0.25, 1.5]),
        ([" (1705752000.250000)", " (1705752001.500000)"], [0.25, 1.5]),
        (["1705752000250", "1705752001500"], [0.25, 1.5]),
        (["1705752000250000", "1705752001500000"], [0.25, 1.5]),
        (["1705752000250000000", "1705752001500000000"], [0.25, 1.5]),
    ],
)
def test_a_number_of_seconds_since_1970_is_a_time_with_its_date(
    tmp_path: Path, numbers: list[str], starts: list[float]
) -> None:
    assert _starts(tmp_path / "log.txt", numbers, "2024-01-20 12:00:00") == starts


def test_a_frame_at_the_front_that_looks_like_a_time_is_no_time(tmp_path: Path) -> None:
    path = tmp_path / "log.txt"
    request, response = rtu_adu(17, bytes.fromhex("0300030001")), rtu_adu(17, b"\x03\x02\0\x07")
    path.write_text(f"{request.hex()} sent\n{response.hex()} received\n" * 3)
    assert request.hex().startswith("1103000300")
    assert _told(_read(path)) == [(3, "ok")] * 3


def _can_lines(frame: bytes, head: str, form: str) -> str:
    pieces = [frame[at : at + 8] for at in range(0, len(frame), 8)]
    if form == "log":
        return "".join(f"{head} can0 {581}#{piece.hex().upper()}\n" for piece in pieces)
    return "".join(
        f" {head}  can0  581   [{len(piece)}]  {piece.hex(' ').upper()}\n" for piece in pieces
    )


@pytest.mark.parametrize("form", ["log", "table"])
def test_a_response_in_pieces_of_eight_bytes_is_joined(tmp_path: Path, form: str) -> None:
    path = tmp_path / "can.txt"
    path.write_text(
        "".join(
            _can_lines(one.data, f"({one.ms / 1000 + 1_705_752_000:.6f})", form)
            for one in conversation()
        )
    )
    assert _told(_read(path)) == expected()


def test_a_response_that_the_log_does_not_show_whole_is_not_blamed_on_the_slave(
    tmp_path: Path,
) -> None:
    path = tmp_path / "log.txt"
    for transport in ("rtu", "tcp"):
        lines = [
            f"{one.time:%H:%M:%S} {'TX' if one.is_request else 'RX'}: "
            f"{one.data[: None if one.is_request else -3].hex(' ')}"
            for one in conversation(transport)
        ]
        path.write_text("\n".join(lines))
        told = [str(one.outcome) for one in _read(path)]
        assert told.count("no-answer") == 1
        assert told.count("not-captured") >= 7


def test_a_response_with_a_wrong_crc_is_told_as_one(tmp_path: Path) -> None:
    path = tmp_path / "log.txt"
    lines = []
    for one in conversation():
        data = one.data if one.is_request else one.data[:-1] + bytes((one.data[-1] ^ 0x40,))
        lines.append(f"{one.time:%H:%M:%S} {'TX' if one.is_request else 'RX'}: {data.hex(' ')}")
    path.write_text("\n".join(lines))
    reading = Reading([str(path)], ReadingOptions())
    events = [str(one.kind) for one in reading.records() if isinstance(one, WireEvent)]
    assert events == ["bad-check"] * 7


def test_zeros_in_a_log_are_passed_over(tmp_path: Path) -> None:
    path = tmp_path / "log.txt"
    text = FORMS["pymodbus"](conversation()).encode()
    middle = text.index(b"\n", len(text) // 2) + 1
    for zeros in (8, 5000):
        path.write_bytes(bytes(zeros) + text[:middle] + bytes(zeros) + text[middle:])
        assert _told(_read(path)) == expected()


def test_zeros_alone_are_no_text(tmp_path: Path) -> None:
    path = tmp_path / "log.txt"
    path.write_bytes(bytes(5000))
    with pytest.raises(InputError, match="begins with 00 00"):
        _read(path)


def _remarks(path: Path, text: str) -> str:
    path.write_text(text)
    with open_capture(path) as capture:
        list(capture.serial(None)[1])
        return capture.remark or ""


def test_times_that_go_back_are_told(tmp_path: Path) -> None:
    said = conversation()
    text = "".join(f"{one.time:%H:%M:%S} TX: {one.data.hex(' ')}\n" for one in [*said, *said])
    assert "its times go back 1 time, first in line 16" in _remarks(tmp_path / "log.txt", text)
    assert "go back" not in _remarks(tmp_path / "log.txt", text[: len(text) // 2])


@pytest.mark.parametrize(
    ("dates", "is_guessed"),
    [
        (["05/06/2024", "05/06/2024"], True),
        (["05-06-2024", "05-06-2024"], True),
        (["05/06/2024", "06/06/2024"], False),
        (["05/06/2024", "13/06/2024"], False),
        (["05.06.2024", "05.06.2024"], False),
    ],
)
def test_an_order_of_day_and_month_that_nothing_shows_is_told(
    tmp_path: Path, dates: list[str], is_guessed: bool
) -> None:
    said = zip(conversation(), dates * 8, strict=False)
    text = "".join(f"{date} 12:00:00 TX: {one.data.hex(' ')}\n" for one, date in said)
    told = _remarks(tmp_path / "log.txt", text)
    assert (f"; {dates[0]} is read as month, day" in told) == is_guessed


def test_the_number_that_changes_at_midnight_is_the_day(tmp_path: Path) -> None:
    heads = ["05/06/2024 23:59:59", "06/06/2024 00:00:01"]
    assert _starts(tmp_path / "log.txt", heads, "2024-06-05 23:59:59") == [0, 2]
    heads = ["05/06/2024 23:59:59", "05/07/2024 00:00:01"]
    assert _starts(tmp_path / "log.txt", heads, "2024-05-06 23:59:59") == [0, 2]


def test_a_table_of_times_and_whole_frames_is_a_text_log(tmp_path: Path) -> None:
    path = tmp_path / "frames.csv"
    rows = "".join(f"{one.ms / 1000:.3f},{one.data.hex()}\n" for one in conversation())
    path.write_text(f"t_start_s,hex\n{rows}")
    assert _told(_read(path)) == expected()


@pytest.mark.parametrize(
    "text",
    [
        "Connected\n[01][03][00][00][00][01][84][0A]\nERROR Bad file descriptor\n",
        "0000 | 01 03 02 00 07 f9 86 | ...\nnext\n0000 | 01 03 02 00 08 b9 82 | ...\n",
        "Transport - TX: 1, 3, 0, 22, 0, 2, 37, 207\n",
        "".join(f"[V]: Read 0b{byte:08b} (0x{byte:02X})\n" for byte in b"\x01\x83\x02\xc0\xf1"),
        "<< writing 01 03 00 00 00 01 84 0A to COM4\ngot (00 01 03 02 00 07)\n",
    ],
)
def test_a_short_log_of_few_frames_counts(tmp_path: Path, text: str) -> None:
    path = tmp_path / "log.txt"
    path.write_text(text)
    assert {function for function, _ in _told(_read(path))} == {3}


def test_the_quick_look_at_a_line_misses_no_bytes() -> None:
    chance = Random(5)
    letters = b'0000000000    ,,--::..xXhH[]<>|;\t_"(\\#=az>'
    found = 0
    for _ in range(60_000):
        line = bytes(chance.choices(letters, k=chance.randint(1, 24)))
        shape = line.translate(SHAPE)
        is_found = MAY_BE_BYTES.search(shape) is not None
        found += is_found
        assert may_be_bytes(line, shape) == is_found, line
    assert found > 5_000
