"""What a report says of polling in which requests are answered, but not as one would have it."""

from __future__ import annotations

from typing import TYPE_CHECKING

import msgspec

from mbtool.core import CONNECTION_OPENED, EventKind, WireEvent
from mbtool.ledger import statistics
from mbtool.modbus import Outcome
from mbtool.modbus.adu import Transport
from tests.ledger.test_history import START, asked
from tests.views.report.test_verdict import judged, polled

if TYPE_CHECKING:
    import pytest

    from mbtool.devices import NamedTransaction

SLAVE, MASTER = "10.0.0.9", "10.0.0.1:50000"


def on_network(at_s: float, latency_ms: int = 5) -> NamedTransaction:
    return msgspec.structs.replace(
        asked(at_s, latency_ms=latency_ms), link=SLAVE, transport=Transport.TCP, source=MASTER
    )


def opened(at_s: float, master: str = MASTER) -> WireEvent:
    return WireEvent(
        ts_ns=START + round(at_s * 1e9), link=SLAVE, kind=EventKind.OPENED,
        message=CONNECTION_OPENED, raw=b"", source=master,
    )  # fmt: skip


def test_answers_much_slower_than_usual_are_told() -> None:
    told = judged([asked(at, latency_ms=990 if at in (40, 90) else 2) for at in range(100)])
    assert told.level == "doubt"
    assert told.sentence == (
        "Nothing grave, but worth a look: unit 1 gives 2 answers late, the longest after 990 ms "
        "(usually 2.0 ms)."
    )


def test_answers_a_little_slower_than_usual_are_none_of_it() -> None:
    assert (
        judged([asked(at, latency_ms=90 if at == 40 else 2) for at in range(100)]).level == "well"
    )
    assert judged([asked(at, latency_ms=990 if at == 4 else 2) for at in range(20)]).level == "well"


def test_a_long_pause_of_polling_is_told_with_the_usual_period() -> None:
    told = judged([asked(at / 4 + (7 if at > 60 else 0)) for at in range(100)])
    assert told.sentence == (
        "Nothing grave, but worth a look: rs485 paused a poll for 7.25 s (usually every 250 ms)."
    )
    assert told.troubles[0].cases_title == ""
    told = judged([on_network(at / 4 + 7 * (at > 30) + 9 * (at > 60)) for at in range(100)])
    assert "10.0.0.1 paused a poll of 10.0.0.9 2 times, for up to 9.25 s (" in told.sentence


def test_the_longest_pauses_have_their_begins_and_lengths() -> None:
    records = [asked(at / 4 + 4 * (at // 20) + (at > 139)) for at in range(200)]
    (pauses,) = judged(records).troubles
    assert "paused a poll 9 times" in pauses.text
    assert pauses.cases_title == "the 5 longest:"
    begins = [139, 19, 39, 59, 79]
    assert pauses.cases == tuple(
        (records[at].start_ns, "for 5.25 s" if at == 139 else "for 4.25 s") for at in begins
    )


def test_the_search_of_late_answers_has_the_latency_from_which_they_are_late() -> None:
    records = [asked(at, latency_ms=990 if at in (40, 90) else 7) for at in range(100)]
    told = judged(records)
    assert [one.search for one in told.troubles] == ["rs485 unit:1 ms>=140"]
    assert list(told.late_ns.values()) == [140_000_000]


def test_requests_without_a_period_do_not_pause() -> None:
    records = [asked(at * at / 3) for at in range(60)]
    assert judged(records).level == "well"


def test_a_connection_for_each_poll_is_told() -> None:
    records = [
        one for at in range(40) for one in (opened(at), on_network(at), on_network(at + 0.1))
    ]
    assert judged(records).sentence == (
        "Nothing grave, but worth a look: 10.0.0.1 opened 40 TCP connections to 10.0.0.9 for "
        "80 requests (one could stay open)."
    )
    assert judged([opened(0), *(on_network(at) for at in range(80))]).level == "well"


def test_connections_without_a_request_are_no_polling() -> None:
    scanned = [opened(at, "10.0.0.7:4000") for at in range(40)]
    assert judged([*scanned, *map(on_network, range(80))]).level == "well"


def test_the_one_that_cost_most_time_comes_first() -> None:
    records = [on_network(at / 4 + (7 if at > 60 else 0), 2) for at in range(99)]
    late = on_network(40, 900)
    told = judged([*records, late, *map(opened, range(60))])
    assert [one.text.split()[1] for one in told.troubles] == ["paused", "1", "opened"]
    assert told.told == 3


def test_a_failing_unit_is_told_before_them() -> None:
    slow = [asked(at, 2, latency_ms=990 if at == 40 else 2) for at in range(100)]
    told = judged([*polled(100, range(0, 100, 4)), *slow])
    assert told.sentence == (
        "Unit 1 leaves 25 % of its requests without an answer; nothing else is grave."
    )
    assert len(told.troubles) == 2


def test_requests_that_are_always_refused_are_named() -> None:
    def read(at: float, address: int, outcome: Outcome = Outcome.OK) -> NamedTransaction:
        one = asked(at, outcome=outcome)
        code = 2 if outcome is Outcome.EXCEPTION else None
        return msgspec.structs.replace(
            one, address=address, quantity=2, reference=f"holding {address}",
            exception=code, exception_name=None if code is None else "illegal data address",
        )  # fmt: skip

    good = [read(at, 0) for at in range(40)]
    bad = [read(at + 0.5, 90, Outcome.EXCEPTION) for at in range(0, 40, 10)]
    assert judged([*good, *bad]).sentence == (
        "Unit 1 always refuses 03 holding 90 (4 times) with 02 illegal data address."
    )
    more = [read(50 + at, 100 + at, Outcome.EXCEPTION) for at in range(3)]
    assert "always refuses 4 of its 5 different requests, such as 03 holding 90, with" in (
        judged([*good, *bad, *more]).sentence
    )
    assert (
        "refuses 17 % of its requests"
        in judged([*good, *bad, *[read(61, 0, Outcome.EXCEPTION)] * 4]).sentence
    )
    scan = [
        msgspec.structs.replace(read(at, at, Outcome.EXCEPTION), unit=unit)
        for unit in range(1, 7)
        for at in range(10)
    ]
    assert judged(scan).sentence == (
        "All 6 units refuse all their requests (60), with 02 illegal data address: "
        "60 different ones, as in a scan."
    )


def test_many_of_one_kind_are_told_as_one() -> None:
    late = [
        asked(at, unit, latency_ms=100 * unit if at == 40 else 2)
        for unit in range(1, 5)
        for at in range(60)
    ]
    assert judged(late).sentence == (
        "Nothing grave, but worth a look: unit 4 gives 1 answer late, after 400 ms "
        "(usually 2.0 ms), and 3 more units."
    )


def test_pauses_of_many_links_or_masters_are_told_as_one() -> None:
    def paused(slave: int, master: int) -> list[NamedTransaction]:
        names = {"link": f"10.0.0.{slave}", "source": f"10.0.1.{master}:50000"}
        polls = [on_network(at / 4 + (7 if at > 60 else 0)) for at in range(100)]
        return [msgspec.structs.replace(one, **names) for one in polls]

    def told(*pairs: tuple[int, int]) -> str:
        return judged([one for pair in pairs for one in paused(*pair)]).sentence

    assert told((1, 1), (2, 1), (3, 1)).endswith(" 250 ms), and 2 more links.")
    assert told((1, 1), (1, 2), (1, 3)).endswith(" 250 ms), and 2 more masters.")
    assert told((1, 1), (1, 2), (2, 1)).endswith(" 250 ms), and 2 more cases.")


def test_connections_are_judged_together_if_some_polls_are_no_longer_known(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(statistics, "MAX_POLLS", 20)
    polls = [
        msgspec.structs.replace(on_network(at / 10), address=at % 200, quantity=1)
        for at in range(400)
    ]
    assert judged([*map(opened, range(25)), *polls]).level == "well"
    told = "opened 200 TCP connections to 10.0.0.9 for 400 requests (one could stay open)."
    assert judged([*map(opened, range(200)), *polls]).sentence.endswith(f": 10.0.0.1 {told}")
    others = [opened(at, f"10.0.0.{at % 2}:50000") for at in range(200)]
    assert judged([*others, *polls]).sentence.endswith(f": masters {told}")
