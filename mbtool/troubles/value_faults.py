"""Finds VALUE-...: numbers in registers that change as a measured quantity does not change.

The numbers in the registers of each poll are followed over the whole recording
(values/movements.py). The profile names the numbers; without a profile, their types are judged from
the values. These rules compare each number with its own usual behaviour, in this recording and in a
baseline recording, if there is one:

- VALUE-STUCK: the number moved, then stays the same for much longer than ever before, while other
  numbers in the same answer move on. A number may rest at 0 or at a round value, and a counter may
  stand still; neither counts.
- VALUE-JUMPED: the number is far away in one answer (or in a few), and then as before; or it moves
  over a long way in small steps, with one large step. If other numbers jump at the same time, the
  plant changed, and nothing is reported.
- VALUE-RESET, VALUE-BACKWARDS: the number only rises, and falls once. A counter that overflows,
  such as after 59, 9999 or 65535, does not count.
- VALUE-NONE: FFFFH, 8000H, 7FFFH (also with 32 bits) or NaN, while all other values are far away.
- VALUE-RANGE, VALUE-NOT-VALID: the number is outside the range that the profile gives, or the
  profile says that a bit or state makes other values invalid.

Registers that a master writes, and ambiguous frames, are left out.
"""

# False alarms: the rules need at least LEARN answers, and many changes before a fault. A process
# can do the same once (such as a lamp that is switched on for a moment), so the troubles have the
# sureness `likely`.
#
# With a baseline, the figures of each poll continue from a copy of the baseline's figures, as after
# a pause of the polling. Faults in the baseline itself are not reported, except values that the
# profile forbids.
#
# Memory: MAX_POLLS polls, with BATCH words or LEARNT answers each; some hundred bytes for each
# number; MAX_JUDGED registers whose types are judged.

from __future__ import annotations

from array import array
from collections.abc import Iterator, Sequence
from copy import deepcopy
from itertools import pairwise
from typing import TYPE_CHECKING, NamedTuple

from mbtool.core.moments import counted, duration
from mbtool.modbus import FUNCTIONS, Outcome
from mbtool.modbus.adu import Verdict
from mbtool.troubles.sense import Sense
from mbtool.troubles.trouble import Evidence, Sureness, Trouble, keep

if TYPE_CHECKING:
    from mbtool.devices import NamedTransaction
    from mbtool.devices.assignment import Assignments
    from mbtool.devices.checking.quiet_run import QuietRun
    from mbtool.ledger.answered_reads import AnsweredValues
    from mbtool.ledger.statistics_report import LinkReport
    from mbtool.modbus.tables import Table
    from mbtool.values.followed_values import FollowedValue
    from mbtool.values.movements import Move, Movements, Occurrence

MAX_POLLS = 512
"""At most this many polls of all units together are followed."""
MAX_WRITTEN = 4096
"""At most this many written registers are remembered; a unit with a further one has no trouble of
values."""
BATCH = 8192
"""A poll's words wait in a list. They are added to the poll's figures once there are at least this
many, and answers of at least LEARNT requests."""
LEARN = 48
"""The least number of answers from which the types of a poll's values are judged. A poll with fewer
has no trouble."""
LEARNT = 4 * LEARN
"""The types of a poll's values are judged again after LEARN, 2 * LEARN and 4 * LEARN answers, and
not after this number of answers."""
MOST_ROWS = 64
"""The types of values are judged from at most this many of a poll's answers, evenly chosen among
all."""
MAX_JUDGED = 1500
"""The types of values are judged for at most this many registers in all, counting only those that
change (judging one takes 3 ms). Polls beyond it are not followed."""
LONG_NS = 86_400_000_000_000
"""The times of a trouble are shown with a date if the answers of its poll span at least this time
(ns, one day)."""

MOVES = 20
"""The least number of changes of a value in the capture. A value with fewer has no trouble that
compares it with its usual behaviour."""
LEVELS = 8
"""The least number of different values (its range divided by its smallest step). A value with fewer
may be a state, and is never called stuck, jumped or without a value."""
REST_ROWS = 40
"""A value is called stuck only if it stayed the same for at least this many answers in a row."""
REST_TIMES = 5
"""A value is called stuck only if its longest rest (answers in a row with the same value) is at
least this many times its second longest one."""
REST_USUAL = 25
"""A value is called stuck only if its longest rest is at least this many times as long as its mean
time between two changes outside of that rest."""
OTHERS_SHARE = 0.5
"""A value is called stuck only if the other values of the same answers changed during its rest at
least at this share (0 to 1) of the rate at which they change otherwise."""
ROUND = 100
"""A value that rests at a multiple of this number (0 included) is never called stuck."""
JUMP = 20
"""Steps of a value are jumps if each is at least this many times as large as the largest of its
other steps."""
MOST_JUMPS = 6
"""At most this many of a value's largest steps are taken for jumps; with more, it has none."""
RETURN_ROWS = 3
"""A value has returned from a jump only if the step back comes at most this many answers after the
jump."""
RETURN_SHARE = 0.2
"""A value has returned from a jump only if it is then at most this share (0 to 1) of the jump's
size away from where it was before."""
MIN_RANGE_IN_STEPS = 4
"""A single jump without a return is reported only if the value's range, less the jump, is at least
this many times its largest other step: the value then moves over a wide range in small steps."""
OTHER_JUMP = 3
"""A step of another value is a jump, too, if it is more than this many times as large as that
value's third largest step. If another value jumps at the same time, no jump is reported."""
MOST_OTHER_STEPS = 2
"""Another value with more steps than this is judged by OTHER_JUMP, one with fewer by
MIN_ROWS_PER_STEP."""
MIN_ROWS_PER_STEP = 50
"""A step of a value with at most MOST_OTHER_STEPS steps counts as a jump, too, if the value has at
least this many answers for each of its steps."""
NONE_DISTANCE = 2
"""A number that devices send instead of a value (such as FFFFH) is reported if its distance from
the value's other numbers is more than this many times their range."""
BACK_STEPS = 5
"""A fall of a counter is reported as VALUE-BACKWARDS if it is at least this many times as large as
the counter's mean step."""
MAX_FALLS_TO_RISES = 0.1
"""A value is a counter only if it falls at most this many times for each of its rises."""
MAX_FALLS_STRETCH = 0.1
"""A value that falls three times or more is a counter only if the answers from its first fall to
its last one are at most this share (0 to 1) of all."""
RESET_SHARE = 0.1
"""A fall of a counter to at most this share (0 to 1) of the number before is VALUE-RESET."""
_MODULI = (
    12, 24, 60, 100, 256, 360, 1000, 1440, 3600, 4096, 10_000, 32_768, 43_200,
    65_536, 86_400, 100_000, 1_000_000, 10_000_000, 16_777_216, 99_999_999, 100_000_000,
    1_000_000_000, 1 << 31, 1 << 32,
)  # fmt: skip
"""A fall is no fault if a counter passed the greatest number below one of these and went on from 0,
as from 59 to 0 with 60."""


_CODES = (
    "VALUE-NOT-VALID", "VALUE-NONE", "VALUE-RANGE", "VALUE-RESET", "VALUE-BACKWARDS",
    "VALUE-JUMPED", "VALUE-STUCK",
)  # fmt: skip
"""The codes, the most important first: only the first of several faults of one register is
reported."""


class _Key(NamedTuple):
    link: str
    unit: int
    function: int
    address: int
    quantity: int


class _Case(NamedTuple):
    """One fault of one number."""

    code: str
    value: FollowedValue
    at_ns: int
    figures: dict[str, str]
    answers: int = 1
    of: int = 0
    until_ns: int | None = None


class _FollowedAnswers:
    """The answers to one kind of request."""

    def __init__(self) -> None:
        self.times = array("q")
        self.words = array("H")
        self.values: list[FollowedValue] = []
        self.learnt = 0
        """The number of answers by which `values` were found."""
        self.usual_ns = 1
        """The usual time from one answer to the next."""
        self.movements: Movements | None = None
        self.rested = 0
        """The number of answers that were dropped because no value changed in them."""
        self.is_left_out = False
        self.norm_ns: tuple[int, int] | None = None
        """The times (UTC ns) of the first and last answer of the baseline; None without one."""
        self.norm_rows = 0
        """The number of answers of the baseline."""

    def after_norm(self, movements: Movements) -> _FollowedAnswers:
        """Return a copy of an answered request of the baseline, to which the answers of the checked
        capture are added. `movements` are its figures.
        """
        poll = deepcopy(self)
        del poll.times[:], poll.words[:]  # `movements` has them, too.
        poll.movements = deepcopy(movements)
        poll.movements.forget_profile_faults()
        poll.norm_ns = movements.first_ns, movements.last_ns
        poll.norm_rows = movements.rows
        return poll


class ValueFaults(Sense):
    """Finds the troubles VALUE-..."""

    def __init__(self, assignments: Assignments) -> None:
        self._assignments = assignments
        self._norm: ValueFaults | None = None
        """The values of the baseline."""
        self._is_compared = False
        """True if a request of the captures is in the baseline, too."""
        self._overlaps = False
        """True if such a request was answered at a time within the baseline."""
        self._is_norm = False
        self._lines: set[str] = set()
        """The serial lines whose values were seen."""
        self._found: list[Trouble] = []
        """The troubles of earlier captures."""
        self._polls: dict[_Key, _FollowedAnswers] = {}
        self._like: dict[_Key, NamedTransaction] = {}
        """For polls of slaves that may have a profile: their first transaction."""
        self._written: set[tuple[str, int, Table, int]] = set()
        self._much_written: set[tuple[str, int]] = set()
        """Units with too many written registers to know all; no trouble is reported for them."""
        self._judged = 0

    def judge_by(self, norm: ValueFaults) -> None:
        """Judge the captures that follow by the values that `norm` has seen as well."""
        self._norm = norm

    def become_norm(self) -> None:
        """Take the next captures as the baseline, for which no trouble is reported."""
        self._is_norm = True

    @property
    def norm_remark(self) -> str | None:
        """A sentence for the user if the baseline could not be used; None if it was used, or if
        there is no baseline.
        """
        if self._overlaps:
            return (
                "the baseline and the checked captures have the same times; values with the same "
                "times are judged without the baseline"
            )
        if self._norm is not None and not self._is_compared:
            return "the checked captures have no request of the baseline; it was not used"
        return None

    def begin_capture(self) -> None:
        if self._is_norm:
            return
        self._found = list(self.troubles(()))
        self._polls.clear()
        self._like.clear()
        self._lines.clear()
        self._written.clear()
        self._much_written.clear()
        self._judged = 0

    def transaction(self, one: NamedTransaction) -> None:
        function = FUNCTIONS.get(one.function)
        if function is None or function.table is None or one.address is None:
            return
        if function.writes:
            address = one.address if one.write_address is None else one.write_address
            count = len(one.request_values or ()) or 1
            self._note_write(one.link, one.unit, function.table, range(address, address + count))
        values = one.response_values
        if one.outcome is not Outcome.OK or not values or Verdict.AMBIGUOUS in one.verdicts:
            return
        if function.table.is_bits and one.device is None:
            return
        key = _Key(one.link, one.unit, one.function, one.address, len(values))
        poll = self._polls.get(key)
        if poll is None:
            if one.transport.is_serial and len(self._polls) < MAX_POLLS:
                self._lines.add(one.link)
            poll = self._new_poll(key, one.start_ns)
            if one.device is not None and key in self._polls:
                self._like[key] = one
        if not poll.is_left_out:
            poll.times.append(one.start_ns)
            poll.words.extend(values)
            self._take(key, poll)

    def run(self, run: QuietRun) -> None:
        rows = run.rows
        for place in run.refused:
            asked, (link, _, _) = rows.asked[place], run.ends(place)
            function, address = FUNCTIONS[asked >> 32 & 0xFF], asked >> 16 & 0xFFFF
            table = function.table if function.writes else None
            if table is not None and not table.is_bits:
                span = range(address, address + (asked & 0xFFFF))
                self._note_write(link, asked >> 40, table, span)

    def reads(self, reads: AnsweredValues) -> None:
        """Take many answered reads and writes of slaves without profiles together."""
        for index, asked in enumerate(reads.asked):
            link, unit, code, address, quantity = asked
            function = FUNCTIONS[code]
            if function.table is None or function.table.is_bits:
                continue
            if function.writes:
                self._note_write(link, unit, function.table, range(address, address + quantity))
                continue
            key = _Key._make(asked)  # Faster than calling _Key.
            poll = self._polls.get(key)
            if poll is None and len(self._polls) >= MAX_POLLS:
                continue
            one = reads[index]
            poll = poll or self._new_poll(key, one.request_ns[0])
            if not poll.is_left_out:
                poll.times.extend(one.request_ns)
                poll.words.frombytes(one.values.words())
                self._take(key, poll)

    def _note_write(self, link: str, unit: int, table: Table, span: range) -> None:
        if len(self._written) < MAX_WRITTEN:
            self._written.update((link, unit, table, address) for address in span)
        else:
            self._much_written.add((link, unit))

    def _new_poll(self, key: _Key, at_ns: int) -> _FollowedAnswers:
        """Return the answers to a request that was answered for the first time, at `at_ns`."""
        poll = _FollowedAnswers()
        if len(self._polls) < MAX_POLLS:
            poll = self._polls[key] = self._continued_norm(key, at_ns) or poll
        poll.is_left_out |= not 0 < key.quantity <= 2000
        return poll

    def _continued_norm(self, key: _Key, at_ns: int) -> _FollowedAnswers | None:
        """Return a copy of the baseline's answers to a request; None if there is none.

        The name of a serial line is that of a port or file, so each serial line of the baseline
        with the same request is taken for the same line; of several the one with most answers.
        """
        if self._norm is None:
            return None
        alike = [
            (movements, poll)
            for norm_key, poll in self._norm._polls.items()
            if norm_key[1:] == key[1:] and self._is_norm_of(norm_key.link, key.link)
            if (movements := self._norm._movements(norm_key, poll)) is not None
        ]
        if not alike:
            return None
        self._is_compared = True
        movements, known = max(alike, key=lambda one: one[0].rows)
        if movements.first_ns <= at_ns <= movements.last_ns:
            self._overlaps = True
            return None
        return known.after_norm(movements)

    def _is_norm_of(self, there: str, link: str) -> bool:
        """True if a link of the baseline is, or may be, a link of the checked captures."""
        norm = self._norm
        if norm is None or there == link:
            return norm is not None
        return there in norm._lines and link in self._lines and link not in norm._lines

    def _take(self, key: _Key, poll: _FollowedAnswers) -> None:
        """Add the answers that wait to the figures of their poll, if they are many."""
        if len(poll.times) >= LEARNT and len(poll.words) >= BATCH:
            self._movements(key, poll)

    def _movements(self, key: _Key, poll: _FollowedAnswers) -> Movements | None:
        """Return the figures of all answers of a poll; None if nothing is known of its values."""
        if poll.movements is None and not poll.is_left_out and len(poll.times) < LEARN:
            return None  # Small captures need no numpy, which loads slowly.
        from mbtool.values.movements import Movements

        rows = len(poll.times)
        if poll.movements is None:
            if not (poll.is_left_out or self._find_values(key, poll)):
                return None
            if poll.is_left_out:
                del poll.times[:], poll.words[:]
                return None
            rows = len(poll.times)
            movements = Movements(poll.values, poll.usual_ns, poll.rested)
            if rows < LEARNT:
                movements.add(poll.times, poll.words.tobytes())
                return movements
            poll.movements = movements
        if rows:
            poll.movements.add(poll.times, poll.words.tobytes())
            del poll.times[:], poll.words[:]
        return poll.movements

    def _find_values(self, key: _Key, poll: _FollowedAnswers) -> bool:
        """Find which values a poll has; return False if it is too early for that.

        Their types are judged from the first LEARN answers, and again from twice as many, until
        LEARNT; so they do not depend on when somebody asks.
        """
        from mbtool.values.followed_values import judged_values, values_of_profile
        from mbtool.values.judging import WordHistory

        table = FUNCTIONS[key.function].table
        assert table is not None
        size = key.quantity
        like = self._like.get(key)
        profile = None if like is None else self._assignments.profile_for(like)
        while True:
            number = LEARN
            while number * 2 <= min(len(poll.times), LEARNT):
                number *= 2
            if len(poll.times) < number:
                return False
            rows = [tuple(poll.words[at : at + size]) for at in range(0, number * size, size)]
            if profile is not None or any(row != rows[0] for row in rows):
                break
            if number < LEARNT:
                return False
            # Registers that never changed tell no type, so later answers are looked at.
            del poll.times[: LEARNT - 1], poll.words[: (LEARNT - 1) * size]
            poll.rested += LEARNT - 1
        if poll.learnt == number:
            return True
        times = poll.times[:number].tolist()
        gaps = sorted(after - before for before, after in pairwise(times))
        poll.usual_ns = max(gaps[len(gaps) // 2], 1)
        if profile is not None:
            poll.values = values_of_profile(profile, table, key.address, size)
        else:
            if not poll.learnt:
                self._judged += sum(len(set(column)) > 1 for column in zip(*rows, strict=True))
            poll.values = []
            if self._judged <= MAX_JUDGED:
                every = -(-number // MOST_ROWS)
                history = WordHistory(table, key.address, times[::every], rows[::every])
                poll.values = judged_values(history)
        poll.learnt = number
        poll.is_left_out = not poll.values
        return True

    def troubles(self, links: Sequence[LinkReport]) -> Iterator[Trouble]:
        yield from self._found
        units: dict[tuple[str, int], list[tuple[Table, Movements, _FollowedAnswers]]] = {}
        for key, poll in self._polls.items():
            table, movements = FUNCTIONS[key.function].table, self._movements(key, poll)
            if table is not None and movements is not None:
                units.setdefault((key.link, key.unit), []).append((table, movements, poll))
        for (link, unit), own in units.items():
            cases = [
                (table, movements, case._replace(of=max(case.of - poll.norm_rows, 0)))
                for table, movements, poll in own
                for case in _value_cases(
                    movements, [one for _, one, _ in own if one is not movements]
                )
                if poll.norm_ns is None or not poll.norm_ns[0] <= case.at_ns <= poll.norm_ns[1]
            ]
            # Report one fault for each register. Several polls may show the same one.
            cases.sort(key=lambda one: _CODES.index(one[2].code))
            if (link, unit) in self._much_written:
                continue
            taken = {each[2:] for each in self._written if each[:2] == (link, unit)}
            if self._norm is not None:
                taken |= {
                    each[2:]
                    for each in self._norm._written
                    if each[1] == unit and self._is_norm_of(each[0], link)
                }
            by_code: dict[str, list[tuple[Movements, _Case]]] = {}
            for table, movements, case in cases:
                first = case.value.address
                span = {(table, at) for at in range(first, first + case.value.reading.words)}
                if taken.isdisjoint(span):
                    taken |= span
                    by_code.setdefault(case.code, []).append((movements, case))
            for code, some in by_code.items():
                yield _trouble(link, unit, code, some)


def _trouble(link: str, unit: int, code: str, cases: list[tuple[Movements, _Case]]) -> Trouble:
    cases.sort(key=lambda one: one[1].at_ns)
    movements, first = cases[0]
    evidence: list[Evidence] = []
    for _, one in cases:
        keep(evidence, Evidence(ts_ns=one.at_ns, text=_case_text(one)))
    more = len(cases) - 1
    return Trouble(
        code=code, link=link, unit=unit, count=sum(one.answers for _, one in cases), of=first.of,
        since_ns=first.at_ns, until_ns=first.until_ns,
        is_long=movements.last_ns - movements.first_ns >= LONG_NS,
        figures={
            "value": first.value.name,
            "times": counted(first.answers, "answer", ","),
            "more": f"; {counted(more, 'more value')} likewise" if more else "",
            **first.figures,
        },
        weight=len(cases), sureness=Sureness.LIKELY, evidence=tuple(evidence),
    )  # fmt: skip


def _case_text(case: _Case) -> str:
    figures = case.figures
    if "before" in figures:
        return f"{case.value.name}: {figures['before']} to {figures['after']}"
    return f"{case.value.name}: {figures.get('number', figures.get('text', ''))}"


def _value_cases(movements: Movements, beside: Sequence[Movements]) -> Iterator[_Case]:
    """Yield the faults of the values of a poll; `beside` has the other polls of the unit."""
    for place, value in enumerate(movements.values):
        unset = movements.unset(place)
        if unset is not None and _is_no_number(movements, place, unset):
            yield _no_value_case(movements, value, unset)
        outside = movements.outside(place)
        if outside is not None:
            yield _Case(
                "VALUE-RANGE", value, outside.at_ns,
                {"number": value.shown(outside.number), "range": _range_text(value)},
                outside.answers, movements.rows,
            )  # fmt: skip
        if outside is None and not value.is_state and movements.changes[place] >= MOVES:
            fault = _fall_case(movements, place)
            if fault is None and _levels(movements, place) >= LEVELS:
                fault = _jump_case(movements, place) or _stuck_case(movements, place, beside)
            if fault is not None:
                yield fault
    for value, text, seen in movements.not_valid():
        yield _Case(
            "VALUE-NOT-VALID", value, seen.at_ns, {"text": text}, seen.answers, movements.rows
        )


def _levels(movements: Movements, place: int) -> float:
    """About the number of different values that a number had."""
    width = movements.high[place] - movements.low[place]
    return float(width / movements.least_step[place]) + 1


def _is_no_number(movements: Movements, place: int, unset: Occurrence) -> bool:
    low, high = float(movements.low[place]), float(movements.high[place])
    if movements.changes[place] < MOVES or _levels(movements, place) < LEVELS:
        return False
    away = max(low - unset.number, unset.number - high)
    if unset.number == (1 << 16 * movements.values[place].reading.words) - 1:
        away = min(away, low + 1)  # FFFFH may be -1, next to 0.
    if not away <= NONE_DISTANCE * (high - low):  # True for NaN as well.
        return True
    # Two steps may be larger than usual, as the number went on meanwhile.
    return away >= JUMP * movements.steps(place)[2].size


def _no_value_case(movements: Movements, value: FollowedValue, unset: Occurrence) -> _Case:
    bits = 16 * value.reading.words
    is_whole = unset.number == unset.number and abs(unset.number) != float("inf")
    word = f"{int(unset.number) % (1 << bits):0{bits // 4}X}H" if is_whole else "no number"
    return _Case(
        "VALUE-NONE", value, unset.at_ns,
        {"number": value.shown(unset.number) if is_whole else "NaN", "word": word},
        unset.answers, movements.rows,
    )  # fmt: skip


def _range_text(value: FollowedValue) -> str:
    low = "" if value.minimum is None else f"{value.minimum:g}"
    high = "" if value.maximum is None else f"{value.maximum:g}"
    if low and high:
        return f"{low} to {high}"
    return f"at least {low}" if low else f"at most {high}"


def _fall_case(movements: Movements, place: int) -> _Case | None:
    """Return the fault of a number that otherwise only rises."""
    value = movements.values[place]
    rises = int(movements.rises[place])
    falls = int(movements.changes[place]) - rises
    first = movements.falls(place)
    if not first or rises < MOVES:
        return None
    step, risen_before = first[0]
    mean = float(movements.risen[place]) / rises
    stretch = int(movements.last_fall[place]) - step.row + 1
    is_once = falls <= 2 or stretch <= MAX_FALLS_STRETCH * movements.rows
    goes_on = rises - risen_before >= 2 or movements.rows - step.row <= RETURN_ROWS
    if not is_once or not goes_on or risen_before < MOVES or falls > rises * MAX_FALLS_TO_RISES:
        return None
    if any(_goes_on_at_zero(value, one, mean) for one, _ in first):
        return None
    if _has_returned(movements, place):
        return None
    figures = {"before": value.shown(step.before), "after": value.shown(step.after)}
    if 0 <= step.after <= RESET_SHARE * step.before:
        return _Case("VALUE-RESET", value, step.at_ns, figures)
    if sum(one.size for one, _ in first) >= BACK_STEPS * mean:
        return _Case("VALUE-BACKWARDS", value, step.at_ns, figures)
    return None


def _goes_on_at_zero(value: FollowedValue, step: Move, mean: float) -> bool:
    """True if a counter goes on at 0 behind its last digit."""
    reach = 3 * mean + 1
    is_float = value.reading.type.is_float
    return not is_float and any(
        modulus - reach <= step.before < modulus + (step.after >= 1)
        and (step.after - step.before) % modulus <= reach < modulus / 2
        for modulus in _MODULI
    )


def _jumps(movements: Movements, place: int) -> tuple[list[Move], float]:
    """Return the steps of a number that are much larger than all others, in the order of time, and
    the largest of the others; no steps if there is no such gap between their sizes.
    """
    steps = movements.steps(place)
    for at in range(1, min(MOST_JUMPS + 1, len(steps))):
        if steps[at - 1].size >= JUMP * steps[at].size:
            return sorted(steps[:at], key=lambda one: one.row), steps[at].size
    return [], 0.0


def _has_returned(movements: Movements, place: int) -> bool:
    jumps, _ = _jumps(movements, place)
    return bool(jumps) and _do_return(jumps)


def _jump_case(movements: Movements, place: int) -> _Case | None:
    value = movements.values[place]
    jumps, usual = _jumps(movements, place)
    if not jumps:
        return None
    jump = jumps[0]
    mean = float(movements.risen[place]) / max(int(movements.rises[place]), 1)
    if any(_goes_on_at_zero(value, one, mean) for one in jumps):
        return None
    is_slow = len(jumps) == 1 and _is_slow(movements, place, jump.size, usual)
    if not (_do_return(jumps) or is_slow) or _jumps_beside(movements, place, jumps):
        return None
    return _Case(
        "VALUE-JUMPED", value, jump.at_ns,
        {
            "before": value.shown(jump.before),
            "after": value.shown(jump.after),
            "usual": value.shown_step(usual),
        },
        max(len(jumps) // 2, 1), movements.rows,
    )  # fmt: skip


def _do_return(jumps: Sequence[Move]) -> bool:
    """True if a number returns from each jump."""
    return len(jumps) % 2 == 0 and all(
        back.row - away.row <= RETURN_ROWS
        and abs(back.after - away.before) <= RETURN_SHARE * away.size
        for away, back in zip(jumps[::2], jumps[1::2], strict=True)
    )


def _is_slow(movements: Movements, place: int, jump: float, usual: float) -> bool:
    width = float(movements.high[place] - movements.low[place])
    return width - jump >= MIN_RANGE_IN_STEPS * usual


def _jumps_beside(movements: Movements, place: int, jumps: Sequence[Move]) -> bool:
    """True if another value of the same answers jumps at the same times."""
    reach = len(jumps) == 1
    for other in range(len(movements.values)):
        steps = movements.steps(other) if other != place else []
        if len(steps) > MOST_OTHER_STEPS:
            steps = [one for one in steps if one.size > OTHER_JUMP * steps[MOST_OTHER_STEPS].size]
        elif len(steps) * MIN_ROWS_PER_STEP > movements.rows:
            continue
        rows = [one.row for one in steps]
        if rows and all(any(abs(row - one.row) <= reach for row in rows) for one in jumps):
            return True
    return False


def _stuck_case(movements: Movements, place: int, beside: Sequence[Movements]) -> _Case | None:
    value = movements.values[place]
    rest, second = movements.rests(place)
    changes = int(movements.changes[place])
    outside = movements.rows - rest.rows
    if (
        rest.rows < REST_ROWS
        or rest.rows < REST_TIMES * second
        or outside <= 0
        or rest.rows * changes < REST_USUAL * outside
        or rest.value % ROUND == 0
        or changes == int(movements.rises[place])
    ):
        return None
    end_ns = movements.last_ns if rest.end_ns is None else rest.end_ns
    others = movements.moves - changes - rest.others
    if others < MOVES:
        if not any(_moves_on(one, (end_ns - rest.begin_ns) / 2) for one in beside):
            return None
    elif rest.others / rest.rows < OTHERS_SHARE * others / outside:
        return None
    return _Case(
        "VALUE-STUCK", value, rest.begin_ns,
        {"number": value.shown(rest.value), "rest": duration(end_ns - rest.begin_ns)},
        rest.rows, movements.rows, rest.end_ns,
    )  # fmt: skip


def _moves_on(movements: Movements, most_ns: float) -> bool:
    """True if a value never rested for longer than a time (ns)."""
    for place, changes in enumerate(movements.changes.tolist()):
        if changes >= MOVES:
            rest, _ = movements.rests(place)
            end_ns = movements.last_ns if rest.end_ns is None else rest.end_ns
            if end_ns - rest.begin_ns <= most_ns:
                return True
    return False
