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
    from mbtool.ledger.answered_run import AnsweredRun

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
        if one.outcome in _FAILED:
            cases = self._cases_of(one)
            if cases is not None:
                cases.append(Evidence.of(one))

    def run(self, run: AnsweredRun) -> None:
        failed = [kind for kind in run.kinds if kind.like.outcome in _FAILED]
        if not failed:
            return
        # The first cases of each unit are kept, in the order of the responses.
        indices = [0] * len(run.kinds)
        for number in run.kind:
            kind = run.kinds[number]
            if kind.like.outcome in _FAILED:
                cases = self._cases_of(kind.like)
                if cases is not None:
                    index = indices[number]
                    cases.append(Evidence(
                        ts_ns=kind.request_ns[index], file=kind.like.file,
                        packets=kind.packets(index),
                    ))  # fmt: skip
                indices[number] += 1

    def _cases_of(self, one: NamedTransaction) -> list[Evidence] | None:
        """Return the cases like this transaction; None if there is no room for one more."""
        key = one.link, one.unit, one.outcome
        cases = self._cases.get(key)
        if cases is None:
            if len(self._cases) >= MAX_UNITS:
                return None
            cases = self._cases[key] = []
        return cases if len(cases) < MAX_EVIDENCE else None

    def proved(self, troubles: Iterable[Trouble]) -> Iterator[Trouble]:
        """Yield the troubles of units with their cases as evidence."""
        for one in troubles:
            outcome = _OUTCOMES.get(one.code)
            if outcome is None or one.unit is None:
                yield one
                continue
            cases = self._cases.get((one.link, one.unit, outcome), [])
            yield replace(one, evidence=tuple(sorted(cases, key=lambda case: case.ts_ns)))
