"""A small plant as transactions: two masters, a device with two units behind it, a gateway."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import msgspec

from mbtool.devices import NamedTransaction
from mbtool.ledger.account import Account
from mbtool.ledger.inventory import inventory
from mbtool.modbus import Outcome, Transport, function_name, mbap_adu
from mbtool.modbus.adu import DirectionBy

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

    from mbtool.ledger.inventory_rows import InventoryDocument, ProfileFit

SECOND = 1_000_000_000
START_NS = 1_700_000_000 * SECOND
SCADA, PANEL = "10.0.0.1", "10.0.0.2"
DRIVE, GATEWAY = "10.0.0.10", "10.0.0.20"


def asked(
    function: int,
    address: int | None = None,
    quantity: int | None = None,
    *,
    master: str | None = SCADA,
    slave: str | None = DRIVE,
    port: int = 502,
    at_s: float = 0,
    **fields: Any,
) -> NamedTransaction:
    """A transaction that went well, unless the fields say otherwise; `slave` None is a line."""
    start_ns = START_NS + round(at_s * SECOND)
    outcome = fields.get("outcome", Outcome.EXCEPTION if "exception" in fields else Outcome.OK)
    has_answer = outcome in (Outcome.OK, Outcome.EXCEPTION)
    defaults: dict[str, Any] = {
        "link": "/dev/ttyUSB0" if slave is None else slave if port == 502 else f"{slave}:{port}",
        "transport": Transport.TCP if slave is not None else Transport.RTU,
        "source": f"{master}:50000" if slave is not None else None,
        "destination": f"{slave}:{port}" if slave is not None else None,
        "unit": 1,
        "function_name": function_name(function),
        "outcome": outcome,
        "request_ns": start_ns,
        "response_ns": start_ns + 5_000_000 if has_answer else None,
        "retries": 0,
        "direction_by": DirectionBy.PORT,
        "confidence": 1.0,
    }
    return NamedTransaction(
        **{**defaults, "function": function, "address": address, "quantity": quantity, **fields}
    )


def named(text: str, **fields: Any) -> NamedTransaction:
    """A device's answer to 2B/0E with its vendor."""
    objects = bytes((1, 0, len(text))) + text.encode()
    response = bytes.fromhex("2b 0e 01 01 00 00") + objects
    return asked(0x2B, response_raw=mbap_adu(0, 1, response), **fields)


def macs(transaction: NamedTransaction, master: str, slave: str) -> NamedTransaction:
    return msgspec.structs.replace(transaction, source_mac=master, destination_mac=slave)


def plant() -> list[NamedTransaction]:
    """Ten rounds of polls, one a second, and an identification."""
    rounds = [
        one
        for second in range(10)
        for one in (
            asked(3, 0, 100, at_s=second),
            asked(3, 0, 10, master=PANEL, at_s=second),
            asked(16, 10, 2, at_s=second),
            asked(4, 0, 8, slave=GATEWAY, unit=3, at_s=second),
            asked(4, 0, 8, slave=GATEWAY, unit=4, at_s=second),
        )
    ]
    return [*rounds, named("ACME", at_s=10)]


def inventory_of(
    transactions: Iterable[NamedTransaction],
    identify: Callable[..., ProfileFit] | None = None,
    maker: Callable[[str], str | None] = lambda _: None,
) -> InventoryDocument:
    account = Account(observes=True)
    for one in transactions:
        account.add(one)
    return inventory(account, ["plant.pcap"], identify, maker)
