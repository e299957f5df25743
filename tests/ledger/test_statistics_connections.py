from __future__ import annotations

import pytest

from mbtool.core import CONNECTION_JOINED, CONNECTION_OPENED, EventKind, WireEvent
from mbtool.ledger.statistics_connections import ConnectionTally


def tally_of(*events: tuple[EventKind, str]) -> ConnectionTally:
    tally = ConnectionTally()
    for kind, message in events:
        tally.add(WireEvent(ts_ns=0, link="10.0.0.9", kind=kind, message=message))
    return tally


def test_opened_and_joined_connections_count_apart() -> None:
    tally = tally_of(
        (EventKind.OPENED, CONNECTION_OPENED),
        (EventKind.OPENED, f"{CONNECTION_OPENED}: TLS, O=Plant"),
        (EventKind.OPENED, CONNECTION_JOINED),
    )
    assert (tally.opened, tally.joined, tally.most_at_once) == (2, 1, 3)


@pytest.mark.parametrize(
    ("reason", "resets", "refused"),
    [("reset", 1, 0), ("refused", 0, 1), ("finished", 0, 0), ("capture-end", 0, 0)],
)
def test_the_reason_of_an_end_is_counted(reason: str, resets: int, refused: int) -> None:
    tally = tally_of((EventKind.CLOSED, f"connection closed: {reason}"))
    assert (tally.closed, tally.resets, tally.refused) == ({reason: 1}, resets, refused)


def test_a_refused_connection_does_not_count_as_opened() -> None:
    opened = EventKind.OPENED, CONNECTION_OPENED
    refused = EventKind.CLOSED, "connection closed: refused"
    tally = tally_of(opened, refused, opened, refused, opened)
    assert (tally.opened, tally.refused) == (1, 2)
    assert tally_of(refused).opened == 0


def test_keep_alives_are_summed_up() -> None:
    tally = tally_of(
        (EventKind.CLOSED, "connection closed: finished, 12 keep-alive probes"),
        (
            EventKind.CLOSED,
            "connection closed: reset, 4 keep-alive probes, the last 3 unanswered",
        ),
    )
    assert (tally.keep_alives, tally.unanswered_keep_alives) == (16, 3)


def test_what_a_tap_refuses_counts_as_refused() -> None:
    assert tally_of((EventKind.REFUSED, "no route to host")).refused == 1


def test_the_most_connections_at_once_are_known() -> None:
    opened = EventKind.OPENED, CONNECTION_OPENED
    closed = EventKind.CLOSED, "connection closed: x"
    assert tally_of(opened, closed, opened, opened, closed, closed, closed).most_at_once == 2


def test_a_message_of_another_edition_is_an_other_end() -> None:
    assert tally_of((EventKind.CLOSED, "\x1b[31mgone")).closed == {"other": 1}
