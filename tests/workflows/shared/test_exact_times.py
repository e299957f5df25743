from __future__ import annotations

from mbtool.core import Chunk, SerialFormat
from mbtool.workflows.shared.reading import ExactTimes

LINE = SerialFormat(9600)


def heard(*steps: float) -> ExactTimes:
    """A line whose bytes end so many characters after each other."""
    now_ns, chunks = 0, [Chunk(ts_ns=0, link="line", data=b"\x01")]
    for step in steps:
        now_ns += round(step * LINE.character_ns)
        chunks.append(Chunk(ts_ns=now_ns, link="line", data=b"\x01"))
    times = ExactTimes()
    assert list(times.noted(iter(chunks), LINE)) == chunks
    return times


def test_bytes_as_far_apart_as_on_a_wire_have_exact_times() -> None:
    assert heard(*[1.0] * 200).is_exact("line")
    assert heard(*[0.95, 5.0] * 100).is_exact("line")
    assert not heard(*[1.0] * 200).is_exact("another line")


def test_one_byte_in_a_hundred_may_be_nearer() -> None:
    assert heard(0.1, 0.1, *[1.0] * 200).is_exact("line")
    assert not heard(0.1, 0.1, 0.1, *[1.0] * 200).is_exact("line")
