"""Captures of simulated plants, with the truth of which response answers which request.

`python -m tests.adversary.network --seeds 20` decodes them and prints a table of what is wrong.
"""

# A capture is decided by a master, a loss (or a pair of losses) and a seed. A loss happens in one
# of three places: the slave (silent, late), the network (a segment is lost and retransmitted) or
# the capture (the network carried a packet, but the capture file lacks it, has it twice, or has
# it in the wrong place). Sequence and acknowledgement numbers are those that the ends had,
# whatever the capture lacks.

from __future__ import annotations

import argparse
import itertools
import random
from dataclasses import dataclass
from typing import TYPE_CHECKING

from mbtool.core import Packet
from tests.adversary.plant import Ids, Master, MasterPlan, Slave, SlavePlan, Talk
from tests.adversary.tcp import MS, SECOND, US, Clock, End, Fate, Path, Seen, Segment
from tests.adversary.truth import Truth

if TYPE_CHECKING:
    from collections.abc import Callable
    from random import Random

START_NS = 1_790_000_000 * SECOND

MASTERS = (
    "constant 0",
    "constant 3",
    "cycle",
    "counting",
    "pipelined constant",
    "pipelined counting",
    "connections",
)
LOSSES = (
    "response lost",
    "request lost",
    "several lost",
    "silent",
    "late",
    "doubled",
    "swapped",
    "retransmitted",
)
PAIRS = tuple(itertools.combinations(LOSSES, 2))
ALL_LOSSES: tuple[tuple[str, ...], ...] = ((), *((one,) for one in LOSSES), *PAIRS)

ONE_ID = (Ids.ZERO, Ids.THREE)


@dataclass(frozen=True, slots=True)
class Simulated:
    """A capture and its truth."""

    packets: list[Packet]
    truth: Truth


def name_of(losses: tuple[str, ...]) -> str:
    return " + ".join(losses) or "none"


def simulate(master: str, losses: tuple[str, ...], seed: int, requests: int = 60) -> Simulated:
    """Run a plant. The same arguments give the same capture."""
    rng = random.Random(f"{master}/{name_of(losses)}/{seed}")
    clock = Clock(START_NS)
    path = Path(clock, _fates(losses, rng), rng.randint(5, 90) * US, rng.randint(5, 90) * US)
    talk = Talk()
    timeout_ns = rng.choice((200, 300, 500, 1000)) * MS
    plans: list[MasterPlan] = []
    reordering: set[int] = set()

    def run(plan: MasterPlan, port: int, then: Callable[[], None] | None = None) -> None:
        number = len(plans)
        plans.append(plan)
        ends = [
            End(
                path,
                connection=number,
                is_master=is_master,
                port=port if is_master else 502,
                first=rng.choice((rng.getrandbits(32), 0xFFFFFFFF - rng.randint(0, 2000))),
                quick=rng.random() < 0.5,
            )
            for is_master in (True, False)
        ]
        ends[0].peer, ends[1].peer = ends[1], ends[0]
        reorders = plan.ids is Ids.COUNTING and plan.depth > 1 and rng.random() < 0.5
        if reorders:
            reordering.add(number)
        in_turn = plan.depth == 1
        slave_plan = SlavePlan(
            reorders=reorders,
            silent=1 / 30 if "silent" in losses else 0.0,
            late=1 / 25 if "late" in losses else 0.0,
            master_timeout_ns=timeout_ns,
            usual_ns=rng.choice((1, 3, 8, 20)) * MS if in_turn or reorders else 3 * MS,
            slow=rng.choice((None, 16, 4)) if in_turn or reorders else None,
        )
        slave = Slave(clock, ends[1], slave_plan, talk, rng)
        one = Master(clock, ends[0], plan, talk, rng)

        def finish() -> None:
            if slave.pending or not all(end.is_idle for end in ends):
                clock.after(50 * MS, finish)
                return
            ends[0].close()
            if then is not None:
                clock.after(50 * MS, then)

        one.on_end = finish
        ends[0].connect(one.start)

    _start(master, run, rng, timeout_ns, requests)
    clock.run()
    seen = _captured(path.seen, losses, rng)
    packets = [
        Packet(
            ts_ns=one.ts_ns,
            link="if0",
            link_type=1,
            data=(frame := one.segment.frame()),
            original_length=len(frame),
        )
        for one in seen
    ]
    timeouts = {number: plan.timeout_ns for number, plan in enumerate(plans)}
    return Simulated(packets, Truth(talk, seen, timeouts, reordering))


def _start(
    master: str,
    run: Callable[[MasterPlan, int, Callable[[], None] | None], None],
    rng: Random,
    timeout_ns: int,
    requests: int,
) -> None:
    repeats, new_id = rng.random() < 0.5, rng.random() < 0.5

    def plan(ids: Ids, count: int, depth: int = 1, *, bursts: bool = False) -> MasterPlan:
        return MasterPlan(
            ids=ids,
            depth=depth,
            bursts=bursts,
            timeout_ns=timeout_ns,
            pause_ns=rng.choice((1, 10, 60)) * MS,
            repeats=repeats,
            new_id_for_retry=new_id,
            requests=count,
        )

    if master == "connections":
        third = requests // 4
        for port in (40001, 40002):
            run(plan(rng.choice(list(Ids)), third), port, None)
        again = plan(rng.choice(ONE_ID), third)
        run(plan(rng.choice(ONE_ID), third), 40003, lambda: run(again, 40003, None))
        return
    if master.startswith("pipelined"):
        kinds = {"pipelined counting": Ids.COUNTING, "pipelined cycle": Ids.CYCLE}
        ids = kinds.get(master) or rng.choice(ONE_ID)
        # A master has no more requests open than it has ids, unless it has one only.
        depth = rng.choice((3, 4) if ids is Ids.CYCLE else (2, 4, 8, 16))
        run(plan(ids, requests, depth, bursts=rng.random() < 0.6), 40001, None)
        return
    ids = {"constant 0": Ids.ZERO, "constant 3": Ids.THREE, "cycle": Ids.CYCLE}.get(
        master, Ids.COUNTING
    )
    run(plan(ids, requests), 40001, None)


def _fates(losses: tuple[str, ...], rng: Random) -> Callable[[Segment], Fate]:
    """Choose segments with data that the network loses on their first way."""
    lost: set[tuple[int, bool, int]] = set()

    def fate(segment: Segment) -> Fate:
        key = segment.connection, segment.from_master, segment.offset
        if "retransmitted" not in losses or not segment.payload or key in lost:
            return Fate.ARRIVES
        if rng.random() > 1 / 25:
            return Fate.ARRIVES
        lost.add(key)
        return rng.choice((Fate.LOST_BEFORE_TAP, Fate.LOST_BEHIND_TAP))

    return fate


def _captured(seen: list[Seen], losses: tuple[str, ...], rng: Random) -> list[Seen]:
    """Make the capture file of what passed the tap."""
    kept = list(seen)
    for loss in losses:
        if loss == "response lost":
            kept = _without(kept, rng, from_master=False)
        elif loss == "request lost":
            kept = _without(kept, rng, from_master=True)
        elif loss == "several lost":
            for _ in range(max(1, len(kept) // 80)):
                start = rng.randrange(len(kept))
                del kept[start : start + rng.randint(3, 10)]
        elif loss == "doubled":
            kept = _doubled(kept, rng)
        elif loss == "swapped":
            kept = _swapped(kept, rng)
    return kept


def _without(seen: list[Seen], rng: Random, *, from_master: bool) -> list[Seen]:
    return [
        one
        for one in seen
        if not one.segment.payload
        or one.segment.from_master is not from_master
        or rng.random() > 1 / 15
    ]


def _doubled(seen: list[Seen], rng: Random) -> list[Seen]:
    """A mirror port that gives some packets twice, a few us apart."""
    doubled = []
    for place, one in enumerate(seen):
        doubled.append(one)
        room = seen[place + 1].ts_ns - one.ts_ns if place + 1 < len(seen) else SECOND
        if rng.random() < 1 / 10 and room > 2 * US:
            doubled.append(Seen(one.ts_ns + min(4 * US, room // 2), one.segment))
    return doubled


def _swapped(seen: list[Seen], rng: Random) -> list[Seen]:
    """A capture from two queues: neighbours of different directions change places."""
    swapped = list(seen)
    place = 0
    while place + 1 < len(swapped):
        first, second = swapped[place], swapped[place + 1]
        differ = first.segment.from_master is not second.segment.from_master
        if differ and second.ts_ns - first.ts_ns < 4 * MS and rng.random() < 1 / 8:
            swapped[place] = Seen(first.ts_ns, second.segment)
            swapped[place + 1] = Seen(second.ts_ns, first.segment)
            place += 1
        place += 1
    return swapped


def main() -> None:
    from tests.adversary.judgement import judge

    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=20, help="how many seeds for each cell")
    parser.add_argument("--first-seed", type=int, default=0, help="the first of these seeds")
    parser.add_argument("--requests", type=int, default=60, help="how many requests for each seed")
    parser.add_argument("--master", choices=MASTERS, action="append", help="only this master")
    parser.add_argument("--no-pairs", action="store_true", help="leave pairs of losses out")
    options = parser.parse_args()
    columns = (
        "transactions",
        "undecidable",
        "wrong",
        "missing",
        "blamed",
        "unasked",
        "excused",
        "doubtful",
    )
    print(f"{'master':20}{'loss':32}" + "".join(f"{column:>13}" for column in columns))
    totals = dict.fromkeys(columns, 0)
    for master in options.master or MASTERS:
        for losses in ALL_LOSSES:
            if options.no_pairs and len(losses) > 1:
                continue
            row = dict.fromkeys(columns, 0)
            for seed in range(options.first_seed, options.first_seed + options.seeds):
                found = judge(simulate(master, losses, seed, options.requests)).counts()
                row = {column: row[column] + found[column] for column in columns}
            for column in columns:
                totals[column] += row[column]
            print(f"{master:20}{name_of(losses):32}" + "".join(f"{row[c]:13}" for c in columns))
    print(f"{'all':52}" + "".join(f"{totals[column]:13}" for column in columns))


if __name__ == "__main__":
    main()
