"""Events of a link."""

from __future__ import annotations

from mbtool.core.events import EventKind, WireEvent


def test_event_kinds_keep_the_values_that_logs_contain() -> None:
    assert {kind.value for kind in EventKind} >= {
        "skipped", "bad-check", "foreign", "gap", "overlap", "discarded", "opened", "closed",
        "unreadable", "cut", "line-error",
    }  # fmt: skip


def test_event_of_a_bus_has_neither_ends_nor_bytes() -> None:
    event = WireEvent(ts_ns=1, link="rs485", kind=EventKind.GAP, message="Bytes are missing.")
    assert (event.source, event.destination, event.raw, event.missing) == ("", "", b"", 0)
