from __future__ import annotations

import tracemalloc

from tests.benchmarks.fuzz_packets import MEMORY_BOUND, Result, fuzz, report


def test_packets_that_nobody_sent_raise_nothing_and_hold_memory_within_bounds() -> None:
    tracemalloc.start()
    try:
        result = fuzz(3_000, seed=2)
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert result.packets == 3_000
    assert result.transactions > 300
    assert {"gap", "overlap", "unreadable", "cut"} <= set(result.events)
    assert peak < MEMORY_BOUND


def test_any_port_is_fuzzed_too() -> None:
    result = fuzz(2_000, seed=4, any_port=True)
    assert result.packets == 2_000
    assert result.transactions > 50


def test_the_same_seed_gives_the_same_packets() -> None:
    one, other = fuzz(300, seed=3), fuzz(300, seed=3)
    assert (one.transactions, one.events) == (other.transactions, other.events)


def test_the_report_says_what_was_held() -> None:
    text = report(Result(packets=10, grown=3 * 2**20))
    assert text.startswith("10 packets in 0 s: nothing was raised\n")
    assert text.endswith("memory grew by 3 MiB; the bound is 256 MiB\n")
