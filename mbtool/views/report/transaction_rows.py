"""Collects the rows of a report's table of transactions: the first, failed and late ones, and those
beside pauses.
"""

# A row is a list of integers, to keep the page small:
#
#     number, microseconds since the first row, link, unit, request, result, outcome,
#     latency in microseconds or -1, codes of findings, and 1 if the request is a retry
#
# Link, request, result, outcome and codes are indices into the list `texts`, because the same texts
# occur often. New texts are cut shorter as the page grows (ROOM), so that it stays below 3 MB.
#
# Memory: the first FIRST rows, and of later ones at most MORE with a failure or a finding, at most
# OF_KIND of each kind for one unit; and what LateAnswers and BesidePauses keep. With `everything`
# there is no limit.

from __future__ import annotations

from collections import Counter, OrderedDict
from collections.abc import Callable, Collection, Iterable, Mapping
from functools import partial
from heapq import heappush, heappushpop
from typing import TYPE_CHECKING, Any, NamedTuple

from msgspec.structs import replace

from mbtool.ledger.account import MAX_POLLS
from mbtool.ledger.poll_statistics import LONGEST, PollKey
from mbtool.ledger.unit_account import UnitKey
from mbtool.modbus import Outcome
from mbtool.troubles.polling import LATE_NS, PAUSE_NS
from mbtool.views.cells import result_text, transaction_text
from mbtool.views.report.late_answers import LateAnswers
from mbtool.views.tables import printable

if TYPE_CHECKING:
    from mbtool.devices import NamedTransaction
    from mbtool.devices.checking.finding import Finding
    from mbtool.devices.checking.quiet_run import QuietRun

# The code below keeps the transactions before and after the longest pauses of each poll, for the
# report's table.
#
# A poll is all equal requests of one master. Only at the end of the capture it is known which of
# its pauses are reported (troubles/polling.py).
#
# Memory: the last transaction of each of at most MAX_POLLS polls, and two transactions for each of
# the LONGEST longest pauses of a poll.

_NEVER_NS = 1 << 63
"""A time (UTC ns) after all others, so that no pause begins with it."""


class _Asked(NamedTuple):
    number: int
    """The number of the transaction in the capture, from 1."""
    one: NamedTransaction


class _Pause(NamedTuple):
    ns: int
    order: int
    """The number of the transaction before the pause, times -1: of equal pauses the first ones are
    kept."""
    before: _Asked
    after: _Asked


class BesidePauses:
    """Collects the transactions beside pauses of at least PAUSE_NS (ns)."""

    def __init__(self) -> None:
        self._last: dict[PollKey, _Asked] = {}
        self._pauses: dict[PollKey, list[_Pause]] = {}
        """For each poll a heap: the shortest pause first."""

    def begin_capture(self) -> None:
        """Note that the next transaction belongs to another capture; the time between is no
        pause.
        """
        self._last.clear()

    def note(self, key: PollKey, number: int, one: NamedTransaction) -> None:
        """Take the next transaction, of the poll `key`; `number` is its number in the capture."""
        last = self._last.get(key)
        asked = _Asked(number, one)
        if last is not None:
            pause_ns = one.start_ns - last.one.start_ns
            if pause_ns < 0:
                return  # It has no response, so it was decoded late.
            if self._is_long(key, pause_ns):
                self._add(key, last, asked)
        self._set_last(key, asked)

    def note_run(
        self,
        run: QuietRun,
        number: int,
        transactions_at: Callable[[list[int]], Iterable[NamedTransaction]],
    ) -> None:
        """Take a batch of transactions, before which `number` were taken.

        `transactions_at` returns those with these indices in the batch.
        """
        slots: dict[PollKey, int] = {}
        asked: list[_Asked | None] = []
        last_places: list[int] = []
        beside: list[tuple[int, int, int, int]] = []
        request_ns = run.rows.request_ns
        for stay in sorted(run.stays((), len(run)).left, key=lambda one: one.number):
            key, slot = PollKey._make(stay.name), len(slots)
            slots[key] = slot
            asked.append(self._last.get(key))
            last_places.append(stay.places[-1])
            last, before = asked[-1], -1
            last_ns = _NEVER_NS if last is None else last.one.start_ns
            for place in stay.places:
                if request_ns[place] - last_ns >= PAUSE_NS:
                    beside.append((place, slot, request_ns[place] - last_ns, before))
                last_ns, before = request_ns[place], place
        beside.sort()

        def asked_at(*places: int) -> list[_Asked]:
            made = zip(places, transactions_at([*places]), strict=True)
            return [_Asked(number + place + 1, one) for place, one in made]

        of_slot = list(slots)
        for after, slot, pause_ns, before in beside:
            if self._is_long(of_slot[slot], pause_ns):
                last = asked[slot] if before < 0 else asked_at(before)[0]
                if last is not None:
                    self._add(of_slot[slot], last, *asked_at(after))
        held = OrderedDict[PollKey, int](dict.fromkeys(self._last, -1))
        """For each poll that is kept: its slot, -1 if it is not in the batch."""
        for key, slot in slots.items():
            if len(held) == MAX_POLLS and key not in held:
                held.popitem(last=False)
            held[key] = slot
        made = iter(asked_at(*(last_places[slot] for slot in held.values() if slot >= 0)))
        self._last = {
            key: self._last[key] if slot < 0 else next(made) for key, slot in held.items()
        }

    def beside(self, begins_ns: Collection[int]) -> dict[int, NamedTransaction]:
        """Return the transactions before and after the pauses that begin at these times (UTC ns),
        by their numbers.
        """
        return {
            asked.number: asked.one
            for pauses in self._pauses.values()
            for pause in pauses
            if pause.before.one.start_ns in begins_ns
            for asked in (pause.before, pause.after)
        }

    def _is_long(self, key: PollKey, pause_ns: int) -> bool:
        """True if a pause is one of the longest of the poll so far."""
        if pause_ns < PAUSE_NS:
            return False
        heap = self._pauses.get(key)
        if heap is None:
            return len(self._pauses) < MAX_POLLS
        return len(heap) < LONGEST or pause_ns > heap[0].ns

    def _set_last(self, key: PollKey, asked: _Asked) -> None:
        if len(self._last) == MAX_POLLS and key not in self._last:
            self._last.pop(next(iter(self._last)))
        self._last[key] = asked

    def _add(self, key: PollKey, before: _Asked, after: _Asked) -> None:
        pause = _Pause(after.one.start_ns - before.one.start_ns, -before.number, before, after)
        heap = self._pauses.setdefault(key, [])
        if len(heap) < LONGEST:
            heappush(heap, pause)
        else:
            heappushpop(heap, pause)


FIRST = 5000
MORE = 8000
OF_KIND = 2000
ROOM = ((600_000, 160), (900_000, 60), (1_200_000, 30))
"""Pairs (size, most): while all texts together have less than `size` characters, a new text is cut
to `most` characters."""
_SHORTEST = 12
_ARROW = " -> "
_WELL = frozenset((Outcome.OK, Outcome.BROADCAST))
_NUMBER, _OUTCOME, _CODES = 0, 6, 8
"""The indices of some fields in a row."""
_DAMAGED = "wrong CRC"
"""The result of a request whose response came with a wrong CRC or LRC, as `watch` has it."""


class TransactionRows:
    """Collects rows from the transactions of a capture, which must come in their order."""

    def __init__(self, *, everything: bool = False) -> None:
        self._everything = everything
        self._places: dict[str, int] = {}
        self._texts: list[str] = []
        self._size = 0
        self._kinds: Counter[tuple[str, int, str]] = Counter()
        self._more = 0
        self._late = LateAnswers()
        self.pauses = BesidePauses()
        """Takes all transactions apart from `add`, as only the statistics know their polls."""
        self._by_time: dict[tuple[str, int | None, int], tuple[list[int], dict[str, None]]] = {}
        """Each kept row and the codes of its findings, by the transaction's link, unit and start
        in ns since 1970; `mark` looks up the row of a finding here. A transaction whose response
        was damaged also stands under the time of the damaged frame, which its finding has."""
        self._retries: set[int] = set()
        """The numbers of the kept rows whose requests are retries."""
        self.begin_ns: int | None = None
        self.rows: list[list[int]] = []
        self.transactions = 0
        self.with_trouble = 0
        """The number of transactions with a finding, or with another outcome than ok."""
        self.kept_with_trouble = 0

    def add(
        self, one: NamedTransaction, codes: Iterable[str], damaged_ns: int | None = None
    ) -> None:
        """Take the next transaction, and keep a row for it if it is among the first ones or failed.

        `codes` are the codes of findings (broken rules) about it that the rules of `check` gave,
        beside the decoder's own in `one.findings`. `damaged_ns` is the time (UTC ns) of its damaged
        response; None if it had none.
        """
        self.transactions += 1
        codes = dict.fromkeys((*one.findings, *codes))
        has_trouble = bool(codes) or one.outcome not in _WELL
        self.with_trouble += has_trouble
        kind = one.link, one.unit, " ".join(codes) or one.outcome.value
        if (
            self._everything
            or self.transactions <= FIRST
            or (has_trouble and self._is_wanted(kind))
        ):
            self._keep(self.transactions, one, codes, damaged_ns)
        elif one.latency_ns is not None:
            unit = UnitKey(one.link, one.unit)
            self._late.offer(unit, one.latency_ns, self.transactions, lambda: one)

    def add_run(
        self,
        run: QuietRun,
        transactions_at: Callable[[list[int]], Iterable[NamedTransaction]],
    ) -> None:
        """Take the transactions of a batch, none of which has a finding. `transactions_at` is as
        for BesidePauses.note_run.
        """
        rows, before = run.rows, self.transactions
        first = len(run) if self._everything else min(max(FIRST - before, 0), len(run))
        self.with_trouble += len(run.refused)
        kept = dict.fromkeys(range(first))
        for place in run.refused:
            kind = run.ends(place)[0], rows.asked[place] >> 40, Outcome.EXCEPTION.value
            if place >= first and self._is_wanted(kind):
                kept[place] = None
        for place, one in zip(kept, transactions_at([*kept]), strict=True):
            self._keep(before + 1 + place, one, {}, None)
        for place, latency_ns in run.slow(LATE_NS):
            if place not in kept:
                unit = UnitKey(run.ends(place)[0], rows.asked[place] >> 40)
                make = partial(_only, transactions_at, place)
                self._late.offer(unit, latency_ns, before + 1 + place, make)
        self.transactions += len(run)

    def _keep(
        self, number: int, one: NamedTransaction, codes: dict[str, None], damaged_ns: int | None
    ) -> None:
        """Keep a row for a transaction."""
        self.kept_with_trouble += bool(codes) or one.outcome not in _WELL
        row = self._row(number, one, codes, is_damaged=damaged_ns is not None)
        self.rows.append(row)
        self._by_time[one.link, one.unit, one.start_ns] = row, codes
        if damaged_ns is not None:
            self._by_time[one.link, one.unit, damaged_ns] = row, codes

    def add_finding(self, finding: Finding) -> None:
        """Add a finding about an earlier transaction to its row, unless the row was not kept."""
        found = self._by_time.get((finding.link, finding.unit, finding.ts_ns))
        if found is None or finding.code in found[1]:
            return
        row, codes = found
        if not codes and self._texts[row[_OUTCOME]] in _WELL:
            self.with_trouble += 1
            self.kept_with_trouble += 1
        codes[finding.code] = None
        row[_CODES] = self._place(" ".join(codes))

    def mark_retry(self, row: UnitKey, at_ns: int, number: int) -> None:
        """Mark the row of a request as that of a retry, or as that of none if `number` is -1.

        `at_ns` is the time of the request in ns since 1970.
        """
        found = self._by_time.get((row.link, row.unit, at_ns))
        if found is not None:
            change = self._retries.add if number > 0 else self._retries.discard
            change(found[0][_NUMBER])

    def document(
        self, late_ns: Mapping[UnitKey, int], pauses_ns: Collection[int] = ()
    ) -> dict[str, Any]:
        """Return rows, texts and counts as JSON data for the page.

        `late_ns` has the latency (ns) from which an answer of a unit is late, for units that have
        late answers. They become rows, and so do the transactions beside pauses that begin at the
        times `pauses_ns` (UTC ns).
        """
        late = dict(self._late.late(late_ns))
        kept = {row[_NUMBER] for row in self.rows} | late.keys()
        beside = {
            number: one
            for number, one in self.pauses.beside(pauses_ns).items()
            if number not in kept
        }
        more = [self._row(number, one, one.findings) for number, one in (late | beside).items()]
        return {
            "begin_us": 0 if self.begin_ns is None else self.begin_ns // 1000,
            "texts": self._texts,
            "rows": sorted([*map(self._with_retry, self.rows), *more], key=lambda row: row[0]),
            "transactions": self.transactions,
            "with_trouble": self.with_trouble,
            "kept_with_trouble": self.kept_with_trouble,
            "late": len(late),
            "beside_pauses": len(beside),
        }

    def _is_wanted(self, kind: tuple[str, int, str]) -> bool:
        """True if a transaction that failed gets a row; `kind` has its link, its unit, and the
        codes of its findings or its outcome.
        """
        self._kinds[kind] += 1
        if self._kinds[kind] > OF_KIND or self._more >= MORE:
            return False
        self._more += 1
        return True

    def _with_retry(self, row: list[int]) -> list[int]:
        """Return a row, with a 1 at its end if its request is a retry."""
        return [*row, 1] if row[_NUMBER] in self._retries else row

    def _row(
        self,
        number: int,
        one: NamedTransaction,
        codes: Iterable[str],
        *,
        is_damaged: bool = False,
    ) -> list[int]:
        if self.begin_ns is None:
            self.begin_ns = one.start_ns
        # Leave out `retries`, because it also counts equal requests at the usual period.
        text, result = transaction_text(replace(one, retries=0) if one.retries else one), ""
        if is_damaged:
            text, result = text.partition(_ARROW)[0], _DAMAGED
        elif _ARROW in text:
            text, _, result = text.partition(_ARROW)
        return [
            number,
            (one.start_ns - self.begin_ns) // 1000,
            self._place(one.link),
            one.unit,
            self._place(text),
            self._place(result or result_text(one)),
            self._place(one.outcome.value),
            -1 if one.latency_ns is None else one.latency_ns // 1000,
            self._place(" ".join(codes)),
        ]

    def _place(self, text: str) -> int:
        """Return the index of a text in the list `texts`, to which a new text is appended.

        A new text is cut to the length that ROOM gives.
        """
        place = self._places.get(text)
        if place is not None:
            return place
        if not self._everything:
            most = next((most for size, most in ROOM if self._size < size), _SHORTEST)
            text = text if len(text) <= most else text[: most - 1] + "…"
        text = printable(text)
        place = self._places.get(text)
        if place is None:
            place = self._places[text] = len(self._texts)
            self._texts.append(text)
            self._size += len(text)
        return place


def _only(
    transactions_at: Callable[[list[int]], Iterable[NamedTransaction]], place: int
) -> NamedTransaction:
    (one,) = transactions_at([place])
    return one
