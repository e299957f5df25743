"""Keeps the first failed requests of each unit, as evidence for its troubles."""

# Memory: MAX_EVIDENCE cases for each kind of failure of at most MAX_UNITS units.

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from mbtool.modbus import Outcome
from mbtool.troubles.sense import Sense
from mbtool.troubles.trouble import MAX_EVIDENCE, Evidence, Trouble

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from mbtool.devices.named_transaction import NamedTransaction

MAX_UNITS = 500
_OUTCOMES = {
    "UNIT-SILENT": Outcome.NO_ANSWER,
    "UNIT-BAD-CRC": Outcome.NO_ANSWER,
    "UNIT-MISSING": Outcome.NO_ANSWER,
    "UNIT-MALFORMED": Outcome.MALFORMED,
    "UNIT-REFUSES": Outcome.EXCEPTION,
}
_FAILED = frozenset(_OUTCOMES.values())


class FailedCases(Sense):
    """Collects failed requests; finds no trouble by itself."""

    def __init__(self) -> None:
        self._cases: dict[tuple[str, int, Outcome], list[Evidence]] = {}

    def transaction(self, one: NamedTransaction) -> None:
        if one.outcome not in _FAILED:
            return
        key = one.link, one.unit, one.outcome
        cases = self._cases.get(key)
        if cases is None:
            if len(self._cases) >= MAX_UNITS:
                return
            cases = self._cases[key] = []
        if len(cases) < MAX_EVIDENCE:
            cases.append(Evidence.of(one))

    def proved(self, troubles: Iterable[Trouble]) -> Iterator[Trouble]:
        """Yield the troubles of units with their cases as evidence."""
        for one in troubles:
            outcome = _OUTCOMES.get(one.code)
            if outcome is None or one.unit is None:
                yield one
                continue
            cases = self._cases.get((one.link, one.unit, outcome), [])
            yield replace(one, evidence=tuple(sorted(cases, key=lambda case: case.ts_ns)))
