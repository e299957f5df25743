"""Events of a link."""

from __future__ import annotations

from dataclasses import replace

import pytest

from mbtool.core.evidence import ConnectionEnd, EventKind, WireEvent


def test_event_kinds_keep_the_values_that_logs_contain() -> None:
    assert {kind.value for kind in EventKind} >= {
        "skipped", "bad-check", "foreign", "gap", "overlap", "discarded", "opened", "closed",
        "unreadable", "cut", "line-error",
    }  # fmt: skip


def test_event_of_a_bus_has_neither_ends_nor_bytes() -> None:
    event = WireEvent(ts_ns=1, link="rs485", kind=EventKind.GAP, message="Bytes are missing.")
    assert (event.source, event.destination, event.raw, event.missing) == ("", "", b"", 0)


@pytest.mark.parametrize(
    ("message", "end"),
    [
        ("connection closed: finished", ConnectionEnd("finished")),
        ("connection closed: finished by the master", ConnectionEnd("finished", "master")),
        (
            "connection closed: reset by the slave, 4 keep-alive probes, the last 3 unanswered",
            ConnectionEnd("reset", "slave", 4, 3),
        ),
        (
            "connection closed: capture-end, 2 keep-alive probes",
            ConnectionEnd("capture-end", "", 2),
        ),
        (
            "connection closed: unused, so it made room for another",
            ConnectionEnd("unused, so it made room for another"),
        ),
        ("something else", None),
    ],
)
def test_the_message_of_a_closed_event_says_how_the_connection_ended(
    message: str, end: ConnectionEnd | None
) -> None:
    event = WireEvent(ts_ns=1, link="a", kind=EventKind.CLOSED, message=message)
    assert ConnectionEnd.of(event) == end
    assert ConnectionEnd.of(replace(event, kind=EventKind.GAP)) is None
