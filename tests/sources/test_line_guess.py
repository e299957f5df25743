"""A line's settings, found on a line that is simulated bit by bit."""

from __future__ import annotations

import random
import re
from functools import cache

import pytest

from mbtool.core import AutoLink, Direction, LinkError, SerialFormat, SerialLink
from mbtool.modbus import ascii_adu, encode_pdu, rtu_adu
from mbtool.serial_line.settings_fit import settings_to_try
from mbtool.sources.line_guess import guess_line
from tests.sources.uart import UartPort, edges_of, receive

MS = 1_000_000
LINK = AutoLink(("/dev/ttyUSB0",))
PERIOD_MS = 100
ALL_BUT_PARITY = "sure; but for the parity, of whose errors this port tells nothing"


def polls(
    line: SerialFormat, seconds: int, *, ascii_: bool, period_ms: int
) -> list[tuple[int, bytes]]:
    """A master that asks three slaves for registers in turn, and their answers."""
    chance = random.Random(7)
    adu = ascii_adu if ascii_ else rtu_adu
    frames: list[tuple[int, bytes]] = []
    # Slow enough for the line.
    period_ms = max(period_ms, 120 * line.character_ns // MS)
    for number in range(seconds * 1000 // period_ms):
        quantity = chance.randint(1, 10)
        unit = 1 + number % 3
        asked = encode_pdu(3, Direction.REQUEST, address=chance.randrange(999), quantity=quantity)
        values = tuple(chance.randrange(65536) for _ in range(quantity))
        answered = encode_pdu(3, Direction.RESPONSE, values=values)
        begin_ns = number * period_ms * MS
        request = adu(unit, asked)
        turnaround_ns = len(request) * line.character_ns + max(5 * MS, 2 * line.t3_5_ns)
        frames += [(begin_ns, request), (begin_ns + turnaround_ns, adu(unit, answered))]
    return frames


@cache
def wire(
    text: str, *, ascii_: bool = False, seconds: int = 60, period_ms: int = PERIOD_MS
) -> tuple[int, ...]:
    line = SerialFormat.parse(text)
    return tuple(edges_of(polls(line, seconds, ascii_=ascii_, period_ms=period_ms), line))


def guess(port: UartPort, link: AutoLink = LINK) -> tuple[SerialLink, str]:
    found = guess_line(link, open_=port.open, clock=port.clock)
    assert port.is_closed
    return found


@pytest.mark.parametrize("text", ["19200-8E1", "9600-8N1", "9600-8O1", "4800-7E1", "115200-8N2"])
def test_a_receiver_with_the_senders_settings_hears_what_was_sent(text: str) -> None:
    line = SerialFormat.parse(text)
    sent = bytes(range(2**line.data_bits))
    heard = list(receive(edges_of([(1000, sent)], line), line))
    assert bytes(one.byte for one in heard) == sent
    assert not any(one.damaged for one in heard)


def test_a_receiver_with_the_other_parity_finds_every_byte_damaged() -> None:
    sent = bytes(range(256))
    edges = edges_of([(1000, sent)], SerialFormat.parse("9600-8O1"))
    heard = list(receive(edges, SerialFormat.parse("9600-8E1")))
    assert bytes(one.byte for one in heard) == sent
    assert all(one.damaged for one in heard)


@pytest.mark.parametrize("like_16550", [True, False])
@pytest.mark.parametrize("marks", [True, False])
@pytest.mark.parametrize("baud", [1200, 2400, 4800, 9600, 19200, 38400, 57600, 115200])
@pytest.mark.parametrize("characters", ["8E1", "8N1"])
def test_usual_rtu_settings_are_found(
    baud: int, characters: str, marks: bool, like_16550: bool
) -> None:
    text = f"{baud}-{characters}"
    found, sentence = guess(UartPort(wire(text), marks=marks, like_16550=like_16550))
    if marks or sentence.endswith(", sure"):
        assert found == SerialLink("/dev/ttyUSB0", SerialFormat.parse(text))
        assert sentence.startswith(f"ttyUSB0: {text} RTU: ")
        assert sentence.endswith(", sure")
    else:
        assert (found.format.baud, found.ascii) == (baud, False)
        assert sentence.endswith("frames have a correct CRC, " + ALL_BUT_PARITY)


@pytest.mark.parametrize(
    ("text", "found_as"),
    [("9600-8O1", "9600-8O1"), ("19200-8O1", "19200-8O1"), ("19200-8N2", "19200-8N1")],
)
def test_rarer_rtu_settings_are_found(text: str, found_as: str) -> None:
    found, sentence = guess(UartPort(wire(text)))
    assert found == SerialLink("/dev/ttyUSB0", SerialFormat.parse(found_as))
    assert sentence.endswith("frames have a correct CRC, sure")


@pytest.mark.parametrize(
    "text", ["9600-7E1", "19200-7E1", "9600-7O1", "4800-7N2", "9600-8N1", "9600-8E1", "2400-7E1"]
)
@pytest.mark.parametrize("link", [LINK, AutoLink(("/dev/ttyUSB0",), only_ascii=True)])
def test_ascii_is_found(text: str, link: AutoLink) -> None:
    found, sentence = guess(UartPort(wire(text, ascii_=True)), link)
    assert found == SerialLink("/dev/ttyUSB0", SerialFormat.parse(text), ascii=True)
    assert sentence.endswith("frames have a correct LRC, sure")


def test_odd_parity_that_the_driver_does_not_tell_is_heard_as_even() -> None:
    found, sentence = guess(UartPort(wire("9600-8O1"), marks=False))
    assert str(found.format) == "9600-8E1"
    assert sentence.endswith(ALL_BUT_PARITY)


@pytest.mark.parametrize("text", ["19200-8E1", "115200-8N1"])
def test_an_adapter_that_hands_over_every_16_ms_is_no_hindrance(text: str) -> None:
    found, sentence = guess(UartPort(wire(text), block_ns=16 * MS))
    assert str(found.format) == text
    assert sentence.endswith("sure")


def test_a_slow_master_is_waited_for() -> None:
    found, sentence = guess(UartPort(wire("9600-8N1", seconds=300, period_ms=4000)))
    assert str(found.format) == "9600-8N1"
    assert sentence.endswith("sure")


def test_the_usual_settings_are_found_at_the_first_look() -> None:
    port = UartPort(wire("19200-8E1"))
    guess(port)
    assert port.tuned == ["19200-8E1", "19200-8O1"]  # The second tells that errors are marked.
    assert port.now_ns < 2_000 * MS


def test_a_rate_that_the_driver_does_not_do_is_passed_over() -> None:
    found, _ = guess(UartPort(wire("9600-8N1"), refuses=19200))
    assert str(found.format) == "9600-8N1"


def test_with_two_taps_the_line_keeps_both() -> None:
    two = AutoLink(("/dev/a", "/dev/b"))
    found, sentence = guess(UartPort(wire("19200-8E1")), two)
    assert found.ports == ("/dev/a", "/dev/b")
    assert sentence.startswith("a+b: 19200-8E1 RTU")


def test_damage_makes_it_likely_and_the_second_is_named() -> None:
    chance = random.Random(3)
    line = SerialFormat.parse("9600-8N1")
    frames = [
        (begin_ns, frame if chance.random() < 0.6 else chance.randbytes(len(frame)))
        for begin_ns, frame in polls(line, 100, ascii_=False, period_ms=PERIOD_MS)
    ]
    found, sentence = guess(UartPort(edges_of(frames, line)))
    assert found.format == line
    assert "frames have a correct CRC, likely; second is " in sentence


@pytest.mark.parametrize(("wait_s", "told_s"), [(None, 60), (20.0, 20), (300.0, 300)])
def test_a_silent_line_is_an_error_after_a_while(wait_s: float | None, told_s: int) -> None:
    port = UartPort([])
    told = rf"@auto: nothing was heard in {told_s} s; does a master poll"
    with pytest.raises(LinkError, match=told):
        guess_line(LINK, wait_s=wait_s, open_=port.open, clock=port.clock)
    assert port.is_closed
    assert port.now_ns < (told_s + 1) * 1_000 * MS
    assert port.tuned == ["19200-8E1"]


@pytest.mark.parametrize("text", ["19200-8E1", "9600-8N1", "9600-8E1", "2400-8N1", "1200-8O1"])
def test_a_meter_that_is_polled_each_30_s_is_found(text: str) -> None:
    port = UartPort(wire(text, seconds=1800, period_ms=30_000))
    told: list[str] = []
    found, sentence = guess_line(LINK, on_progress=told.append, open_=port.open, clock=port.clock)
    assert str(found.format) == text
    assert "2 of 2 frames have a correct CRC, likely, from so few frames" in sentence
    places = [str(one) for one in settings_to_try()]
    assert port.now_ns <= (places.index(text) + 1) * 30_000 * MS + 6_000 * MS
    assert all(re.fullmatch(r"heard [\d,]+ bytes? in \d+ s, .* fits so far", line) for line in told)


def test_the_search_says_what_fits_so_far() -> None:
    # Only the master is heard, so that two polls are needed.
    line = SerialFormat.parse("9600-8N1")
    request = rtu_adu(1, bytes.fromhex("03 0000 0002"))
    port = UartPort(edges_of([(number * 30_000 * MS, request) for number in range(60)], line))
    told: list[str] = []
    found, _ = guess_line(LINK, on_progress=told.append, open_=port.open, clock=port.clock)
    assert found.format == line
    assert any(
        re.fullmatch(r"heard \d+ bytes in \d+ s, nothing fits so far", each) for each in told
    )
    assert any(
        re.fullmatch(r"heard \d+ bytes in \d+ s, 9600-8N1 RTU fits so far", each) for each in told
    )


def test_a_search_ends_when_the_user_said() -> None:
    line = SerialFormat.parse("1200-8O1")
    port = UartPort(edges_of(polls(line, 900, ascii_=False, period_ms=30_000), line))
    with pytest.raises(LinkError, match="no usual line settings fit what was heard"):
        guess_line(LINK, wait_s=100, open_=port.open, clock=port.clock)
    assert port.now_ns < 101_000 * MS


def test_what_is_no_modbus_fits_nothing() -> None:
    chance = random.Random(5)
    line = SerialFormat.parse("9600-8N1")
    frames = [(number * 50 * MS, chance.randbytes(20)) for number in range(8000)]
    port = UartPort(edges_of(frames, line))
    with pytest.raises(LinkError, match=r"no usual line settings fit what was heard; nearest is"):
        guess(port)
    assert port.is_closed
    assert len(port.tuned) == 24
