"""Transactions for statistics: what a master of tests/ledger/masters.py asked, with bytes."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from mbtool.core import SerialFormat
from mbtool.devices.named_transaction import NamedTransaction
from mbtool.modbus import Outcome, Transport, rtu_adu
from mbtool.modbus.adu import DirectionBy
from tests.ledger.masters import MS, START_NS

if TYPE_CHECKING:
    from collections.abc import Iterable

    from mbtool.ledger.poll_cycle import Asked

LINE = SerialFormat(9600, 8, "E", 1)
QUANTITY = 10


def request(at_ms: float = 0, address: int | None = 0, **fields: Any) -> NamedTransaction:
    """A read of QUANTITY holding registers of unit 1, answered after 5 ms, unless told else."""
    at_ns = START_NS + round(at_ms * MS)
    defaults: dict[str, Any] = {
        "link": "line",
        "transport": Transport.RTU,
        "unit": 1,
        "function": 3,
        "function_name": "read holding registers",
        "address": address,
        "quantity": QUANTITY,
        "outcome": Outcome.OK,
        "request_ns": at_ns,
        "response_ns": at_ns + 5 * MS,
        "latency_ns": 5 * MS,
        "retries": 0,
        "request_raw": rtu_adu(1, bytes.fromhex(f"03 {address or 0:04x} {QUANTITY:04x}")),
        "response_raw": rtu_adu(1, bytes([3, 2 * QUANTITY]) + bytes(2 * QUANTITY)),
        "direction_by": DirectionBy.FORM,
        "confidence": 1.0,
    }
    return NamedTransaction(**{**defaults, **fields})


def unanswered(at_ms: float = 0, address: int = 0, **fields: Any) -> NamedTransaction:
    """A request that the slave leaves without an answer."""
    return request(
        at_ms,
        address,
        **{
            "outcome": Outcome.NO_ANSWER,
            "response_ns": None,
            "latency_ns": None,
            "response_raw": None,
            **fields,
        },
    )


def requests_of(asked: Iterable[Asked[str]]) -> list[NamedTransaction]:
    """The transactions of a master whose polls have letters as names: the letter is the address.

    The frames take the time that they take at LINE, on both sides of the latency.
    """
    made = []
    for one in asked:
        sample = request(0, ord(one.poll))
        sent_ns = len(sample.request_raw or b"") * LINE.character_ns
        at_ms = (one.begin_ns + sent_ns - START_NS) / MS
        if one.is_missing:
            made.append(unanswered(at_ms, ord(one.poll)))
        else:
            made.append(request(at_ms, ord(one.poll), response_ns=one.end_ns + sent_ns))
    return made
