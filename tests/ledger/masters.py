"""Masters with known lists, run on a clock of their own: what they asked and when."""

# A master has tasks; each has a list of polls and a period, or none if it runs without pause. One
# request is open at a time. A poll without answer is repeated after the timeout, then given up.
# This is written from what masters do, without a look at how their lists are found again.

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from random import Random

from mbtool.ledger.poll_cycle import Asked

MS = 1_000_000
START_NS = 1_767_225_600_000_000_000


@dataclass(frozen=True, kw_only=True)
class Task:
    """A list of polls and how often it is asked."""

    polls: Sequence[str]
    period_ms: float | None = None
    """From one begin to the next, by a timer; None if the next cycle follows the pause."""
    pause_ms: float = 0
    """From the end of a cycle to the next, where there is no timer."""
    phase_ms: float = 0
    gap_ms: tuple[float, float] = (2, 4)
    """From a response to the next request of the list."""


@dataclass(frozen=True, kw_only=True)
class Master:
    """Runs tasks; operators write in between."""

    tasks: Sequence[Task]
    dead: frozenset[str] = frozenset()
    loss: float = 0.0
    """The share of requests, at random, that get no answer."""
    retries: int = 0
    timeout_ms: float = 300
    latency_ms: tuple[float, float] = (5, 9)
    latencies: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    writes: Mapping[str, float] = field(default_factory=dict)
    """What is written at random times: the mean time between two, in ms."""
    skip_after_failure: int = 0
    """In how many cycles a poll is left out after it got no answer."""
    timer_jitter_ms: float = 0

    def run(self, seconds: float, seed: int = 1) -> list[Asked[str]]:
        return _Run(self, Random(seed)).until(seconds * 1000)


class _Run:
    def __init__(self, master: Master, random: Random) -> None:
        self._master = master
        self._random = random
        self._now_ms = 0.0
        self._asked: list[Asked[str]] = []
        self._due = [task.phase_ms for task in master.tasks]
        self._next: list[list[str]] = [[] for _ in master.tasks]
        self._writes = {poll: random.expovariate(1 / mean) for poll, mean in master.writes.items()}
        self._left_out: dict[str, int] = {}

    def until(self, end_ms: float) -> list[Asked[str]]:
        while self._now_ms < end_ms:
            self._write()
            task = min(range(len(self._due)), key=lambda one: self._due[one])
            write_ms = min(self._writes.values(), default=end_ms)
            if self._now_ms < write_ms < self._due[task]:
                self._now_ms = write_ms
                continue
            self._now_ms = max(self._now_ms, self._due[task])
            self._cycle(task)
        return self._asked

    def _write(self) -> None:
        for poll, at_ms in self._writes.items():
            if at_ms <= self._now_ms:
                self._ask(poll)
                self._now_ms += self._random.uniform(2, 4)
                mean = self._master.writes[poll]
                self._writes[poll] = self._now_ms + self._random.expovariate(1 / mean)

    def _cycle(self, number: int) -> None:
        task = self._master.tasks[number]
        begin_ms = self._due[number]
        for poll in task.polls:
            if self._left_out.get(poll, 0) > 0:
                self._left_out[poll] -= 1
                continue
            self._ask(poll)
            self._now_ms += self._random.uniform(*task.gap_ms)
            self._write()
        if task.period_ms is None:
            self._due[number] = self._now_ms + task.pause_ms
        else:
            due = begin_ms + task.period_ms
            self._due[number] = max(due, self._now_ms) + self._random.uniform(
                0, self._master.timer_jitter_ms
            )

    def _ask(self, poll: str) -> None:
        for _ in range(1 + self._master.retries):
            begin_ms = self._now_ms
            is_lost = poll in self._master.dead or self._random.random() < self._master.loss
            if not is_lost:
                latency = self._master.latencies.get(poll, self._master.latency_ms)
                self._now_ms += self._random.uniform(*latency)
            self._note(poll, begin_ms, is_missing=is_lost)
            if not is_lost:
                return
            self._now_ms = begin_ms + self._master.timeout_ms
        self._left_out[poll] = self._master.skip_after_failure

    def _note(self, poll: str, begin_ms: float, *, is_missing: bool) -> None:
        begin = START_NS + round(begin_ms * MS)
        end = begin if is_missing else START_NS + round(self._now_ms * MS)
        self._asked.append(Asked(poll, begin, end, is_missing))


Scenario = Callable[[], list[Asked[str]]]
