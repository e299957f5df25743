"""Notes what units answer, for their identification: identity texts, and different requests."""

# Memory: at most MAX_REQUESTS different requests of all units together, and MAX_TEXTS texts of one
# name for each unit.

from __future__ import annotations

from typing import TYPE_CHECKING

from mbtool.devices.identity import answer_word
from mbtool.devices.observed_slave import ObservedSlave
from mbtool.modbus.functions import FUNCTIONS
from mbtool.modbus.identification import identities
from mbtool.modbus.transaction import Outcome

if TYPE_CHECKING:
    from mbtool.devices import NamedTransaction
    from mbtool.ledger.unit_account import UnitAccount

MAX_REQUESTS = 131_072
"""The most different requests of all units together; further ones are not noted."""
MAX_TEXTS = 4
"""The most different identity texts of one name that are kept of a unit."""
MODEL_CODE = "model code"
UNANSWERED = frozenset((Outcome.NO_ANSWER, Outcome.NOT_CAPTURED, Outcome.BROADCAST))
"""Outcomes of transactions in which no response of the slave was seen."""


class Observation:
    """Notes requests and responses with the account of their unit."""

    def __init__(self) -> None:
        self.left_out = 0
        """The number of transactions that were not noted, as there were MAX_REQUESTS."""
        self._requests = 0

    def note(self, unit: UnitAccount, one: NamedTransaction) -> None:
        """Take a transaction of the unit; of equal ones the first is enough."""
        _note_identity(unit, one)
        observed = self._observed(unit, one)
        if observed is not None:
            before = len(observed.requests)
            observed.note(one)
            self._requests += len(observed.requests) - before

    def note_usual(
        self, unit: UnitAccount, like: NamedTransaction, address: int, quantity: int
    ) -> None:
        """Take an answered read or write of the unit: one like `like`, with these addresses."""
        observed = self._observed(unit, like)
        if observed is not None:
            self._requests += observed.note_usual(like, address, quantity)

    def _observed(self, unit: UnitAccount, one: NamedTransaction) -> ObservedSlave | None:
        """Return what takes a transaction of the unit; None if it is not noted."""
        if unit.observed is None:
            if one.outcome in UNANSWERED:
                return None  # Only a unit that has answered is compared with profiles.
            link = "" if one.destination is not None else one.link
            unit.observed = ObservedSlave(link, one.destination, one.unit)
        if self._requests >= MAX_REQUESTS:
            self.left_out += 1
            return None
        return unit.observed


def _note_identity(unit: UnitAccount, one: NamedTransaction) -> None:
    """Keep the texts in a response with which a unit names itself, or its model code."""
    if one.response_raw is None or one.exception is not None:
        return
    texts = [(each.name, each.text) for each in identities(one)]
    if one.function not in FUNCTIONS:
        word = answer_word(one)
        texts = [] if word is None else [(MODEL_CODE, f"{word:04X}H")]
    for name, text in texts:
        known = unit.identity.setdefault((one.function, name), [])
        if text not in known and len(known) < MAX_TEXTS:
            known.append(text)
