"""The pace of a virtual line, without a clock."""

from __future__ import annotations

import sys

import pytest
from hypothesis import given
from hypothesis import strategies as st

if sys.platform == "win32":
    pytest.skip("a virtual line needs Linux or macOS", allow_module_level=True)

from mbtool.sources.virtual_line_hub import MAX_PENDING, Sender

CHARACTER_NS = 573_000


def test_a_character_has_passed_one_character_time_after_it_was_written() -> None:
    sender = Sender(CHARACTER_NS)
    sender.put(b"ab", 1000)
    assert sender.next_ns == 1000 + CHARACTER_NS
    assert sender.take(1000 + CHARACTER_NS - 1) == b""
    assert sender.take(1000 + CHARACTER_NS) == b"a"
    assert sender.take(1000 + 2 * CHARACTER_NS) == b"b"
    assert sender.next_ns is None


def test_a_late_wake_up_does_not_shift_what_follows() -> None:
    sender = Sender(CHARACTER_NS)
    sender.put(b"abcd", 0)
    assert sender.take(2 * CHARACTER_NS + 5) == b"ab"
    assert sender.next_ns == 3 * CHARACTER_NS


def test_what_is_written_during_a_character_follows_it() -> None:
    sender = Sender(CHARACTER_NS)
    sender.put(b"a", 0)
    sender.put(b"b", CHARACTER_NS // 2)
    assert sender.take(CHARACTER_NS) == b"a"
    assert sender.next_ns == 2 * CHARACTER_NS


def test_room_ends_at_the_bound() -> None:
    sender = Sender(CHARACTER_NS)
    sender.put(bytes(MAX_PENDING), 0)
    assert sender.room == 0
    sender.take(CHARACTER_NS)
    assert sender.room == 1


@given(
    writes=st.lists(st.tuples(st.integers(0, 3_000_000), st.binary(min_size=1, max_size=20))),
    looks=st.integers(100_000, 2_000_000),
)
def test_nothing_is_early_lost_or_out_of_order(writes: list[tuple[int, bytes]], looks: int) -> None:
    sender = Sender(CHARACTER_NS)
    now_ns, heard, earliest_ns = 0, b"", 0
    for wait_ns, data in writes:
        now_ns += wait_ns
        heard += sender.take(now_ns)
        sender.put(data, now_ns)
        earliest_ns = max(earliest_ns, now_ns) + len(data) * CHARACTER_NS
    while sender.next_ns is not None:
        now_ns += looks
        heard += sender.take(now_ns)
    assert heard == b"".join(data for _, data in writes)
    assert not writes or now_ns >= earliest_ns
