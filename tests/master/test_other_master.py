"""What is learned of another master on a serial line before a request is sent."""

from __future__ import annotations

from random import Random

import pytest

from mbtool.core import LinkError, SerialLink, parse_link
from mbtool.master.other_master import MARGIN_NS, OtherMaster
from mbtool.modbus import ascii_adu, rtu_adu

MS = 1_000_000
READ_1 = rtu_adu(1, bytes.fromhex("03 0010 0004"))
ANSWER_1 = rtu_adu(1, bytes.fromhex("03 08 0001 0002 0003 0004"))
READ_2 = rtu_adu(2, bytes.fromhex("04 0000 0001"))
ANSWER_2 = rtu_adu(2, bytes.fromhex("04 02 0007"))


def line(text: str = "rtu:/dev/ttyUSB0@19200-8N1") -> SerialLink:
    link = parse_link(text, "a serial line")
    assert isinstance(link, SerialLink)
    return link


def heard(link: SerialLink, cycles: int, pause_ms: int = 400) -> tuple[OtherMaster, int]:
    """Another master's polls of units 1 and 2, and the time in ns of the last byte."""
    other, now_ns = OtherMaster(link), 10**12
    for _ in range(cycles):
        for frame, wait_ms in ((READ_1, pause_ms), (ANSWER_1, 5), (READ_2, 20), (ANSWER_2, 8)):
            raw = ascii_adu(frame[0], frame[1:-2]) if link.ascii else frame
            now_ns += wait_ms * MS + len(raw) * link.format.character_ns
            other.feed(raw, now_ns)
            other.feed(b"", now_ns + 4 * MS)
    return other, now_ns


@pytest.mark.parametrize("text", ["rtu:/dev/ttyUSB0@19200-8N1", "ascii:/dev/ttyUSB0@19200-7E1"])
def test_says_who_asks_what_and_how_often(text: str) -> None:
    other, _ = heard(line(text), 5)
    other.end(2_000_000_000)
    with pytest.raises(LinkError, match="Nothing was sent; --between asks in its pauses") as told:
        other.demand_free()
    assert "unit 1 03 holding 16..19 every " in str(told.value)
    assert "unit 2 04 input 0 every " in str(told.value)


def test_a_silent_line_is_free() -> None:
    other = OtherMaster(line())
    other.feed(b"", 10**12)
    other.end(10**9)
    other.demand_free()


def test_a_few_stray_bytes_are_no_other_speaker_and_many_are() -> None:
    for size, is_free in ((3, True), (60, False)):
        other = OtherMaster(line())
        other.feed(bytes(range(0x80, 0x80 + size)), 10**12)
        other.feed(b"", 10**12 + 2 * 10**9)
        other.end(2 * 10**9)
        if is_free:
            other.demand_free()
            continue
        with pytest.raises(LinkError, match=f"{size} bytes .* no frame.*@auto finds"):
            other.demand_free()


def test_the_pause_behind_a_poll_is_the_shortest_one_heard() -> None:
    other, now_ns = heard(line(), 6)
    longest_ns = 0.9 * (400 * MS)
    assert other.longest_pause_ns == pytest.approx(longest_ns, rel=0.02)
    assert other.silence_left_ns(now_ns + 4 * MS) == pytest.approx(longest_ns - 4 * MS, rel=0.02)
    assert other.silence_left_ns(now_ns + 500 * MS) == 0


def test_no_pause_is_sure_before_it_was_heard_three_times() -> None:
    other, now_ns = heard(line(), 3)  # Two pauses lie between three cycles.
    assert other.longest_pause_ns == pytest.approx(0.9 * 20 * MS, rel=0.1)
    assert other.silence_left_ns(now_ns + 4 * MS) == 0


def test_there_is_no_pause_while_a_request_begins() -> None:
    other, now_ns = heard(line(), 6)
    assert other.silence_left_ns(now_ns + 50 * MS) > MARGIN_NS
    other.feed(READ_1[:1], now_ns + 60 * MS)
    assert other.silence_left_ns(now_ns + 61 * MS) == 0


def test_a_pause_is_used_once() -> None:
    other, now_ns = heard(line(), 6)
    other.note_our_request()
    assert other.silence_left_ns(now_ns + 4 * MS) == 0


def test_the_latency_of_a_unit_is_the_longest_heard() -> None:
    other, _ = heard(line(), 6)
    latency_ns = other.latency_ns(2)
    assert latency_ns is not None
    assert 8 * MS <= latency_ns <= 10 * MS
    assert other.latency_ns(7) is None


def test_another_master_with_ever_new_requests_is_remembered_in_bounded_memory() -> None:
    other, now_ns = OtherMaster(line()), 10**12
    for address in range(600):
        request = rtu_adu(1, b"\x03" + address.to_bytes(2) + b"\x00\x01")
        for frame in (request, rtu_adu(1, bytes.fromhex("03 02 0000"))):
            now_ns += 20 * MS
            other.feed(frame, now_ns)
            other.feed(b"", now_ns + 4 * MS)
    assert len(other.polls) == 256


def frames(other: OtherMaster, link: SerialLink, now_ns: int, *waits: tuple[bytes, int]) -> int:
    """Let frames be heard, each after a silence in ms; return the time of the last byte in ns."""
    for frame, wait_ms in waits:
        now_ns += wait_ms * MS + len(frame) * link.format.character_ns
        other.feed(frame, now_ns)
        other.feed(b"", now_ns + 4 * MS)
    return now_ns


def test_a_pause_is_known_again_after_bytes_were_missed() -> None:
    link = line()
    other, now_ns = heard(link, 6)
    known_ns = other.longest_pause_ns
    now_ns += 2_000 * MS
    other.listen_anew(now_ns)
    now_ns = frames(other, link, now_ns, (READ_2, 20), (ANSWER_2, 8))
    assert other.longest_pause_ns == known_ns
    assert other.silence_left_ns(now_ns + 4 * MS) == 0  # The poll of unit 1 may come at any moment.
    now_ns = frames(other, link, now_ns, (READ_1, 400), (ANSWER_1, 5), (READ_2, 20), (ANSWER_2, 8))
    assert other.silence_left_ns(now_ns + 4 * MS) > 300 * MS


def test_a_poll_that_has_stopped_is_no_longer_awaited() -> None:
    link = line()
    other, now_ns = heard(link, 6)
    for _ in range(4):
        now_ns = frames(other, link, now_ns, (READ_2, 420), (ANSWER_2, 8))
    assert other.silence_left_ns(now_ns + 4 * MS) > 300 * MS


def test_a_pause_ends_where_a_poll_at_a_fixed_time_is_due() -> None:
    link = line()
    other, now_ns = OtherMaster(link), 10**12
    for _ in range(6):  # Each 300 ms, however long the answer takes.
        begin_ns = now_ns
        frames(other, link, begin_ns, (READ_1, 0), (ANSWER_1, 10))
        now_ns = begin_ns + 300 * MS
    answered_ns = frames(other, link, now_ns, (READ_1, 0), (ANSWER_1, 200))
    rest_ns = other.silence_left_ns(answered_ns + 4 * MS)
    assert 0 < answered_ns + 4 * MS + rest_ns <= now_ns + 300 * MS + 8 * link.format.character_ns


@pytest.mark.parametrize("seed", range(8))
def test_no_request_falls_into_the_silence_that_is_promised(seed: int) -> None:
    # Two timers, one at each third time of the other, and answers that become slower.
    chance, link = Random(seed), line()
    other, now_ns = OtherMaster(link), 10**12
    polls = [(READ_1, ANSWER_1, 430), (READ_2, ANSWER_2, 1_290)]
    due_ns = [now_ns, now_ns + chance.randint(170, 300) * MS]
    promises, broken, promised_ns = 0, 0, 0
    for number in range(200):
        place = due_ns.index(min(due_ns))
        request, answer, period_ms = polls[place]
        begin_ns = max(due_ns[place], now_ns + 5 * MS)
        is_broken = number >= 30 and promised_ns > begin_ns
        broken += is_broken
        due_ns[place] += period_ms * MS
        latency_ms = chance.randint(5, 20 if number < 30 else 120)
        now_ns = frames(other, link, begin_ns, (request, 0), (answer, latency_ms))
        rest_ns = other.silence_left_ns(now_ns + 4 * MS)
        promises += rest_ns >= 100 * MS
        promised_ns = now_ns + 4 * MS + rest_ns
    assert promises > 20
    assert broken == 0


def test_bytes_of_others_beside_our_request_shorten_the_pause() -> None:
    link = line()
    other, now_ns = heard(link, 6)
    assert other.longest_pause_ns > 300 * MS
    other.note_our_request()
    other.note_intrusion(now_ns + 110 * MS, 250 * MS)  # A busy machine read them late.
    assert other.longest_pause_ns > 300 * MS
    now_ns = frames(other, link, now_ns + 420 * MS, (READ_1, 0), (ANSWER_1, 5), (READ_2, 20),
                    (ANSWER_2, 8))  # fmt: skip
    other.note_our_request()
    other.note_intrusion(now_ns + 120 * MS)
    assert other.longest_pause_ns == pytest.approx(0.9 * 120 * MS)
    assert other.silence_left_ns(now_ns + 130 * MS) == 0


def test_bytes_that_were_read_late_tell_nothing_of_a_pause() -> None:
    link = line()
    other, now_ns = heard(link, 6)
    known_ns, period_ns = other.longest_pause_ns, other.polls[READ_1].shortest_period_ns
    # A busy machine: the request seems to come after 50 ms, and may have come up to 350 ms later.
    now_ns += 50 * MS
    other.feed(READ_1, now_ns, 350 * MS)
    cycle = ((ANSWER_1, 5), (READ_2, 20), (ANSWER_2, 8), (READ_1, 400))
    now_ns = frames(other, link, now_ns + 350 * MS, *cycle, *cycle[:3])
    assert other.longest_pause_ns == known_ns
    assert other.polls[READ_1].shortest_period_ns == period_ns
    assert other.silence_left_ns(now_ns + 4 * MS) > 300 * MS


def test_a_unit_that_may_still_answer_the_other_master_is_not_asked() -> None:
    link = line()
    other, now_ns = heard(link, 6)
    # Unit 1 does not answer, then answers the request before in place of the present one.
    cycle = ((READ_1, 400), (READ_2, 20), (ANSWER_2, 8))
    now_ns = frames(other, link, now_ns, *cycle)
    assert other.silence_left_ns(now_ns + 4 * MS, unit=2) > 0
    assert other.silence_left_ns(now_ns + 4 * MS, unit=1) == 0
    late = rtu_adu(1, bytes.fromhex("03 02 0001"))
    for answer, is_free in ((late, False), (ANSWER_1, False), (ANSWER_1, True)):
        now_ns = frames(other, link, now_ns, (READ_1, 400), (answer, 5), *cycle[1:])
        assert (other.silence_left_ns(now_ns + 4 * MS, unit=1) > 0) == is_free
