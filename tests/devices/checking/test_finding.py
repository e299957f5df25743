from __future__ import annotations

from mbtool.core import EventKind
from mbtool.devices.checking.finding import event_finding, is_joined, transaction_finding
from mbtool.devices.checking.rules import Severity
from tests.devices.checking.talk import LINK, MASTER, SLAVE, START_NS, event, opened, transaction


def test_a_finding_says_where_its_transaction_was() -> None:
    one = transaction_finding(
        "FT1A-A3", transaction(profile="idec-ft1a-touch", at_ms=5), "what happened"
    )
    assert (one.link, one.source, one.destination, one.unit) == (LINK, MASTER, SLAVE, 1)
    assert (one.device, one.reference, one.function) == ("idec-ft1a-touch", "HR400001", 3)
    assert one.ts_ns == START_NS + 5_000_000
    assert one.severity is Severity.ERROR


def test_a_finding_about_an_event_has_its_words() -> None:
    one = event_finding("TCP-202", event(EventKind.SKIPPED, message="8 bytes"))
    assert (one.message, one.link, one.source, one.unit) == ("8 bytes", LINK, MASTER, None)
    assert event_finding("TCP-202", event(EventKind.SKIPPED), "other").message == "other"


def test_a_connection_that_was_open_before_is_joined() -> None:
    assert is_joined(opened(joined=True))
    assert not is_joined(opened())
