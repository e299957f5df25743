"""The rule for WAGO 750 couplers: a watchdog that has expired."""

# Manual of the WAGO-I/O-SYSTEM 750, watchdog registers (from 1000H on): once the watchdog has
# expired, the coupler responds with exception 04 to every request until the watchdog is started
# again. A single exception 04 between other responses is a failed request; two in a row mean that
# the watchdog has expired.
#
# Memory: for each coupler, the first exception 04 in a row (LruDict in sliding_window.py).

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from mbtool.devices.checking.finding import Finding, transaction_finding
from mbtool.devices.checking.sliding_window import LruDict
from mbtool.devices.checking.transactions import request_text
from mbtool.devices.model import BehaviourName
from mbtool.devices.named_transaction import NamedTransaction
from mbtool.modbus.functions import ExceptionCode

if TYPE_CHECKING:
    from collections.abc import Iterator

    from mbtool.devices.model import Profile


@dataclass(slots=True)
class _Coupler:
    first: NamedTransaction | None = None
    """The first transaction with exception 04 since the coupler last gave another response; None
    if there is none."""
    is_reported: bool = False


class WagoRules:
    """Finds couplers whose watchdog has expired (finding WAGO-X1)."""

    def __init__(self) -> None:
        self._couplers: LruDict[str, _Coupler] = LruDict(_Coupler)

    def transaction(self, transaction: NamedTransaction) -> Iterator[Finding]:
        """Check the next transaction of a coupler. Gives WAGO-X1 if its watchdog has expired."""
        coupler = self._couplers[transaction.destination or transaction.link]
        if transaction.exception == ExceptionCode.SERVER_DEVICE_FAILURE:
            if coupler.first is None:
                coupler.first = transaction
            elif not coupler.is_reported:
                coupler.is_reported = True
                yield transaction_finding(
                    "WAGO-X1",
                    coupler.first,
                    f"exception 04 to {request_text(coupler.first)}, and to the request after it",
                )
        elif transaction.response_raw is not None:
            coupler.first, coupler.is_reported = None, False


def is_wago(profile: Profile) -> bool:
    """True if the profile is that of a WAGO 750 coupler, or extends such a profile."""
    return profile.behaviour is BehaviourName.WAGO
