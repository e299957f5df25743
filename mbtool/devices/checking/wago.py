"""What only the WAGO 750 couplers do: after their watchdog ran out they answer nothing else."""

# Manual of the WAGO-I/O-SYSTEM 750, watchdog registers (1000H and following): when the watchdog has
# run out, every request is answered with exception 04, until it is started again. One exception 04
# between other answers is a failure of the request; one after another is the watchdog.
#
# Holds for each coupler its first exception 04 of a row (kept.py).

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from mbtool.devices.checking.finding import Finding, found
from mbtool.devices.checking.lru_dict import LruDict
from mbtool.devices.checking.transactions import asked_for
from mbtool.devices.model import BehaviourName
from mbtool.devices.named_transaction import NamedTransaction
from mbtool.modbus.functions import ExceptionCode

if TYPE_CHECKING:
    from collections.abc import Iterator

    from mbtool.devices.model import Profile


@dataclass(slots=True)
class _Coupler:
    first: NamedTransaction | None = None
    """The first exception 04 since another answer."""
    is_told: bool = False


class WagoRules:
    """Transactions of couplers in; findings out."""

    def __init__(self) -> None:
        self._couplers: LruDict[str, _Coupler] = LruDict(_Coupler)

    def transaction(self, transaction: NamedTransaction) -> Iterator[Finding]:
        """Take the next transaction of a coupler."""
        coupler = self._couplers[transaction.destination or transaction.link]
        if transaction.exception == ExceptionCode.SERVER_DEVICE_FAILURE:
            if coupler.first is None:
                coupler.first = transaction
            elif not coupler.is_told:
                coupler.is_told = True
                yield found(
                    "WAGO-X1",
                    coupler.first,
                    f"exception 04 to {asked_for(coupler.first)}, and to the request after it",
                )
        elif transaction.response_raw is not None:
            coupler.first, coupler.is_told = None, False


def is_wago(profile: Profile) -> bool:
    """Whether a profile is of this family, or of a user's that builds on it."""
    return profile.behaviour is BehaviourName.WAGO
