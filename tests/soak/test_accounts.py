"""What the soak's accounts call missing, and what they allow."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from tests.soak.accounts import SECOND_NS, Life, Told, Verdict, account
from tests.soak.asked import Asked, Touch, request_pdu, rtu_adu, slow_response

BEGIN_NS = 1_700_000_000 * SECOND_NS
PDU = request_pdu(2)
REQUEST, RESPONSE = rtu_adu(1, PDU), rtu_adu(1, slow_response(PDU))


def asked(after_s: float, response: bytes = RESPONSE, touch: Touch = Touch.NONE) -> Asked:
    at_ns = BEGIN_NS + int(after_s * SECOND_NS)
    return Asked("line", REQUEST, at_ns, response, at_ns + 1000 if response else 0, touch)


def record(after_s: float, response: bytes = RESPONSE) -> dict[str, Any]:
    found = {"outcome": "ok", "link": "line", "request_raw": REQUEST.hex()}
    return {
        **found,
        "request_ns": BEGIN_NS + int(after_s * SECOND_NS),
        **({"response_raw": response.hex()} if response else {}),
    }


def verdict(
    one: Asked,
    records: list[dict[str, Any]],
    *,
    is_killed: bool = False,
    events: list[dict[str, Any]] | None = None,
) -> Verdict:
    life = Life([Path("x.mcap")], BEGIN_NS, BEGIN_NS + 100 * SECOND_NS, is_killed)
    accounts = account([one], records, Told([life], events or []))
    ((found, count),) = accounts.verdicts["line"].items()
    assert count == 1
    return found


def gap(after_s: float, message: str) -> dict[str, Any]:
    at_ns = BEGIN_NS + int(after_s * SECOND_NS)
    return {"kind": "gap", "link": "line", "ts_ns": at_ns, "message": message}


def test_what_is_in_the_log_is_whole_or_unanswered_as_it_was() -> None:
    assert verdict(asked(10), [record(10)]) is Verdict.WHOLE
    assert verdict(asked(10, b""), [record(10, b"")]) is Verdict.REQUEST_ONLY


def test_what_is_absent_without_a_reason_is_missing() -> None:
    assert verdict(asked(10), []) is Verdict.MISSING
    assert verdict(asked(10), [record(90)]) is Verdict.MISSING
    assert verdict(asked(10), [record(10, b"\1\2")]) is Verdict.WRONG


def test_only_the_last_second_before_a_kill_may_be_missing() -> None:
    assert verdict(asked(99.5), [], is_killed=True) is Verdict.TOLD
    assert verdict(asked(98.9), [], is_killed=True) is Verdict.MISSING
    assert verdict(asked(99.5), []) is Verdict.MISSING


def test_between_the_events_of_an_unplugged_port_it_may_be_missing() -> None:
    events = [gap(10, "lost"), gap(20, "is back after 10 s")]
    assert verdict(asked(15), [], events=events) is Verdict.TOLD
    assert verdict(asked(21), [], events=events) is Verdict.MISSING
    assert verdict(asked(21), [], events=events[:1]) is Verdict.TOLD


def test_what_the_plant_damaged_itself_need_not_be_there() -> None:
    assert verdict(asked(10, touch=Touch.DAMAGED_REQUEST), []) is Verdict.DISTURBED


def test_a_whole_transaction_that_nobody_sent_is_invented() -> None:
    other = {**record(10), "request_raw": "ff"}
    life = Life([Path("x.mcap")], BEGIN_NS, BEGIN_NS + 100 * SECOND_NS)
    assert account([asked(10)], [record(10), other], Told([life], [])).invented
