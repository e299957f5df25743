from __future__ import annotations

import pytest

from tests.benchmarks.tap import (
    Polls,
    Stream,
    measure_polls,
    measure_stream,
    report_polls,
    report_stream,
)


@pytest.mark.parametrize("tls", [False, True], ids=["plain", "tls"])
def test_a_stream_passes_unchanged_and_is_recorded(tls: bool) -> None:
    stream = measure_stream(3_000_000, tls=tls)
    assert stream.is_unchanged
    assert len(set(stream.hashes)) == 1
    assert report_stream(stream).startswith("3000000 bytes each way, unchanged, all recorded: ")


@pytest.mark.parametrize(
    ("hashes", "lost", "is_unchanged"),
    [
        ("aaaa", 0, True),
        ("abaa", 0, False),
        ("aaab", 0, False),
        ("aaab", 9, True),
        ("abab", 9, False),
    ],
)
def test_a_difference_is_seen_unless_the_record_tells_its_loss(
    hashes: str, lost: int, is_unchanged: bool
) -> None:
    stream = Stream(1, 1.0, (hashes[0], hashes[1], hashes[2], hashes[3]), lost)
    assert stream.is_unchanged is is_unchanged
    assert ("CHANGED" in report_stream(stream)) is not is_unchanged


@pytest.mark.parametrize("tls", [False, True], ids=["plain", "tls"])
def test_each_way_is_polled_and_compared_with_the_direct_one(tls: bool) -> None:
    polls = measure_polls(5, 2, tls=tls)
    assert [(one.way, len(one.taken_ns)) for one in polls] == [
        ("direct", 10),
        ("tap", 10),
        ("sniff", 10),
    ]
    assert [line.split()[0] for line in report_polls(polls).splitlines()] == [
        "way",
        "direct",
        "tap",
        "sniff",
    ]


def test_what_a_way_adds_is_its_median_less_the_direct_one() -> None:
    report = report_polls([Polls("direct", [20_000] * 3), Polls("tap", [20_000, 90_000, 95_000])])
    assert report.splitlines()[2].split() == ["tap", "90", "95", "70"]
