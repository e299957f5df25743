from __future__ import annotations

from fractions import Fraction

from hypothesis import given
from hypothesis import strategies as st

from mbtool.replay.bus import AHEAD_NS, BusPlayer, ByteRun
from mbtool.replay.clock import PlayClock

MS = 1_000_000
CHARACTER_NS = MS // 2
SILENCE_NS = 2 * MS
BEGIN = 1_700_000_000_000_000_000


class Played:
    """A player whose clock stands where a test puts it."""

    def __init__(
        self, *pieces: ByteRun, rate: Fraction | None = Fraction(1), is_loop: bool = False
    ) -> None:
        length_ns = pieces[-1].position_ns if pieces else 0
        self.clock = PlayClock(length_ns, rate=rate, gap_ns=100 * MS, is_loop=is_loop)
        self.clock.run(BEGIN)
        self.player = BusPlayer(
            pieces, self.clock, character_ns=CHARACTER_NS, silence_ns=SILENCE_NS
        )

    def sent(self, at_ms: float) -> list[bytes]:
        """What is sent at a moment."""
        sent = []
        while (piece := self.player.next_run(BEGIN + round(at_ms * MS))) is not None:
            sent.append(piece.data)
        return sent

    def wake(self, at_ms: float) -> float | None:
        wake_ns = self.player.wake_ns(BEGIN + round(at_ms * MS))
        return None if wake_ns is None else (wake_ns - BEGIN) / MS


def test_runs_are_sent_at_their_times() -> None:
    played = Played(ByteRun(0, b"a"), ByteRun(10 * MS, b"b"), ByteRun(20 * MS, b"c"))
    assert played.sent(0) == [b"a"]
    assert (played.wake(1), played.sent(9.9), played.sent(10)) == (10, [], [b"b"])
    assert (played.player.has_ended, played.sent(25)) == (False, [b"c"])
    assert played.player.has_ended
    assert list(played.player.lateness.values) == [0, 0, 5 * MS]
    assert (played.player.sent, played.player.bytes, played.player.delayed) == (3, 3, 0)


def test_a_frame_waits_for_the_line_and_its_silence() -> None:
    played = Played(ByteRun(0, b"1234", after_silence=True), ByteRun(MS, b"5", after_silence=True))
    assert played.sent(0) == [b"1234"]
    assert (played.sent(3.9), played.wake(1), played.sent(4)) == ([], 4, [b"5"])
    assert (played.player.delayed, list(played.player.lateness.values)) == (1, [0])
    assert played.player.passed_ns == BEGIN + 4 * MS + CHARACTER_NS


def test_bytes_that_follow_without_a_silence_do_not_wait() -> None:
    played = Played(ByteRun(0, b"12"), ByteRun(MS, b"34"))
    assert played.sent(1.2) == [b"12", b"34"]  # Both late: the port sends one behind the other.
    assert played.player.passed_ns == BEGIN + round(1.2 * MS) + 4 * CHARACTER_NS


def test_a_line_that_is_too_slow_is_not_flooded() -> None:
    size = 2 * AHEAD_NS // CHARACTER_NS
    played = Played(ByteRun(0, bytes(size)), ByteRun(MS, b"b"))
    played.sent(0)
    assert (played.sent(1), played.wake(1)) == ([], AHEAD_NS / MS)
    assert played.sent(AHEAD_NS / MS) == [b"b"]
    assert played.player.delayed == 1


def test_maximum_speed_keeps_the_silences_between_frames() -> None:
    played = Played(
        ByteRun(0, b"ab", after_silence=True),
        ByteRun(900 * MS, b"c", after_silence=True),
        rate=None,
    )
    assert played.sent(0) == [b"ab"]
    assert (played.sent(2.9), played.sent(3)) == ([], [b"c"])


def test_a_pause_stops_sending_and_a_step_sends_one_run() -> None:
    played = Played(ByteRun(0, b"a"), ByteRun(10 * MS, b"b"), ByteRun(20 * MS, b"c"))
    played.sent(0)
    played.clock.pause(BEGIN + MS)
    assert (played.sent(50), played.wake(50)) == ([], None)
    played.player.allow_step(BEGIN)
    assert played.wake(60) == 60
    assert (played.sent(60), played.sent(61)) == ([b"b"], [])
    played.clock.run(BEGIN + 70 * MS)
    assert (played.sent(79.9), played.sent(80)) == ([], [b"c"])  # 10 ms behind the step.


def test_a_loop_begins_again_after_a_gap() -> None:
    played = Played(ByteRun(0, b"a"), ByteRun(10 * MS, b"b"), is_loop=True)
    assert [played.sent(at) for at in (0, 10, 109, 110, 120)] == [
        [b"a"],
        [b"b"],
        [],
        [b"a"],
        [b"b"],
    ]
    assert (played.player.sent, played.player.has_ended) == (4, False)


def test_an_empty_recording_ends_at_once() -> None:
    assert Played().player.has_ended


@given(
    st.lists(
        st.tuples(st.integers(0, 50 * MS), st.binary(min_size=1, max_size=9), st.booleans()),
        min_size=1,
        max_size=20,
    ),
    st.sampled_from([Fraction(1), Fraction(1, 3), Fraction(64), None]),
)
def test_every_byte_is_sent_once_in_order_and_none_early(
    steps: list[tuple[int, bytes, bool]], rate: Fraction | None
) -> None:
    pieces, place = [], 0
    for step, data, silence in steps:
        place += step
        pieces.append(ByteRun(place, data, silence))
    played = Played(*pieces, rate=rate)
    now_ns, sent = BEGIN, []
    while not played.player.has_ended:
        piece = played.player.next_run(now_ns)
        if piece is None:
            wake_ns = played.player.wake_ns(now_ns)
            assert wake_ns is not None
            assert wake_ns > now_ns
            now_ns = wake_ns
        else:
            sent.append(piece)
            if rate is not None:
                assert now_ns - BEGIN >= piece.position_ns / rate - 1
    assert sent == pieces
    assert played.player.bytes == sum(len(piece.data) for piece in pieces)


def test_an_hour_is_played_without_a_drift() -> None:
    every = 997 * MS
    pieces = [ByteRun(number * every, b"x") for number in range(3611)]
    played = Played(*pieces, rate=Fraction(1, 3))
    now_ns = BEGIN
    while not played.player.has_ended:
        if played.player.next_run(now_ns) is None:
            # What wakes it is always a little late, each time by another amount.
            now_ns = (played.player.wake_ns(now_ns) or 0) + 50_000 + now_ns % 40_000
    ideal_ns = BEGIN + 3 * 3610 * every
    assert 3610 * every > 3599 * 1_000 * MS
    assert 0 <= now_ns - ideal_ns < MS
