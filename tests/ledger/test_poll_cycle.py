from __future__ import annotations

from random import Random

import pytest

from mbtool.ledger.poll_cycle import Asked, PollLists, find_lists
from tests.ledger.masters import MS, START_NS, Master, Task

SEEDS = (1, 2, 3, 4, 5)

# Each master has the lists that its tasks name. A list that runs without a pause has no first poll,
# so any rotation of it is right; its name ends in a tilde.
MASTERS: dict[str, tuple[Master, float, list[str]]] = {
    "a list with a timer": (Master(tasks=[Task(polls="abcd", period_ms=1000)]), 60, ["abcd"]),
    "a list with a pause": (Master(tasks=[Task(polls="abcd", pause_ms=1000)]), 60, ["abcd"]),
    "a list without pause": (Master(tasks=[Task(polls="abcd")]), 20, ["abcd~"]),
    "slaves of very different speed": (
        Master(tasks=[Task(polls="abcd")], latency_ms=(1, 200)), 100, ["abcd~"],
    ),
    "one poll": (Master(tasks=[Task(polls="a", period_ms=500)]), 60, ["a"]),
    "a poll twice in a list": (Master(tasks=[Task(polls="abac", period_ms=1000)]), 60, ["abac"]),
    "a poll twice without pause": (Master(tasks=[Task(polls="abac")]), 20, ["abac~"]),
    "each poll twice": (Master(tasks=[Task(polls="aabb", period_ms=500)]), 60, ["aabb"]),
    "a poll thrice in a row": (Master(tasks=[Task(polls="aaab", period_ms=1000)]), 60, ["aaab"]),
    "two lists, 300 and 1000 ms": (
        Master(tasks=[Task(polls="ab", period_ms=300), Task(polls="cdef", period_ms=1000)]),
        120, ["ab", "cdef"],
    ),
    "two lists, 500 and 1000 ms": (
        Master(tasks=[Task(polls="a", period_ms=500), Task(polls="bc", period_ms=1000)]),
        120, ["a", "bc"],
    ),
    "two lists with a phase": (
        Master(tasks=[
            Task(polls="a", period_ms=500), Task(polls="b", period_ms=1000, phase_ms=250),
        ]),
        120, ["a", "b"],
    ),
    "a fast list that waits for a slow one": (
        Master(tasks=[
            Task(polls="ax", period_ms=500, phase_ms=1), Task(polls="bcdefg", period_ms=1000),
        ]),
        120, ["ax", "bcdefg"],
    ),
    "two lists, 1 and 10 s": (
        Master(tasks=[Task(polls="abc", period_ms=1000), Task(polls="defg", period_ms=10_000)]),
        300, ["abc", "defg"],
    ),
    "three lists": (
        Master(tasks=[
            Task(polls="ab", period_ms=200), Task(polls="cd", period_ms=1000),
            Task(polls="efg", period_ms=5000),
        ]),
        120, ["ab", "cd", "efg"],
    ),
    "retries under a timer": (
        Master(tasks=[Task(polls="abcde", period_ms=1000)], loss=0.05, retries=2), 120, ["abcde"],
    ),
    "retries": (
        Master(tasks=[Task(polls="abcde", pause_ms=100)], loss=0.1, retries=2), 120, ["abcde"],
    ),
    "a dead unit": (
        Master(tasks=[Task(polls="abcde", pause_ms=500)], dead=frozenset("c"), retries=2),
        120, ["abcde"],
    ),
    "a dead unit that is asked once": (
        Master(tasks=[Task(polls="abcde", pause_ms=500)], dead=frozenset("c")), 120, ["abcde"],
    ),
    "a dead unit last, under a timer": (
        Master(tasks=[Task(polls="abcde", period_ms=2000)], dead=frozenset("e"), retries=1),
        120, ["abcde"],
    ),
    "a dead unit that is asked in each tenth cycle": (
        Master(
            tasks=[Task(polls="abcde", pause_ms=500)], dead=frozenset("c"), skip_after_failure=9
        ),
        300, ["abde", "c"],
    ),
    "writes in between": (
        Master(tasks=[Task(polls="abcd", period_ms=500)], writes={"W": 3000, "V": 9000}),
        120, ["abcd"],
    ),
    "many writes in between": (
        Master(tasks=[Task(polls="abcd", period_ms=500)], writes={"W": 400}), 120, ["abcd"],
    ),
    "writes into a list without pause": (
        Master(tasks=[Task(polls="abcd")], writes={"W": 300, "V": 300}), 60, ["abcd~"],
    ),
    "all of it": (
        Master(
            tasks=[Task(polls="abcdab", period_ms=1000), Task(polls="efgh", period_ms=7000)],
            writes={"W": 3000}, loss=0.02, retries=1, dead=frozenset("g"), timer_jitter_ms=20,
        ),
        300, ["abcdab", "efgh"],
    ),
    "a short capture": (Master(tasks=[Task(polls="abcd", period_ms=1000)]), 2.5, ["abcd"]),
}  # fmt: skip


def lists_of(found: PollLists[str]) -> list[str]:
    return ["".join(one.polls) for one in found.lists]


def is_list(found: str, wanted: str) -> bool:
    if not wanted.endswith("~"):
        return found == wanted
    right = wanted.rstrip("~")
    return found in {right[at:] + right[:at] for at in range(len(right))}


@pytest.mark.parametrize("name", MASTERS)
def test_the_lists_of_a_master_are_found(name: str) -> None:
    master, seconds, wanted = MASTERS[name]
    for seed in SEEDS:
        found = lists_of(find_lists(master.run(seconds, seed)))
        assert len(found) == len(wanted), (seed, found)
        pairs = zip(found, wanted, strict=True)
        assert all(is_list(one, right) for one, right in pairs), (seed, found)


@pytest.mark.parametrize("name", ["a list with a timer", "two lists, 300 and 1000 ms", "one poll"])
def test_the_time_of_a_cycle_is_the_period_of_its_timer(name: str) -> None:
    master, seconds, _ = MASTERS[name]
    found = find_lists(master.run(seconds))
    periods = [task.period_ms for task in master.tasks]
    assert [round(one.period_ns / MS) for one in found.lists] == periods


def test_an_alternating_delay_does_not_change_the_mean_cycle_time() -> None:
    master, seconds, _ = MASTERS["a fast list that waits for a slow one"]
    fast, slow = find_lists(master.run(seconds)).lists
    assert fast.period_ns / MS == pytest.approx(500, rel=0.02)
    assert fast.times[0] / MS < 480
    assert slow.period_ns / MS == pytest.approx(1000, rel=0.01)


def test_what_is_in_no_list_is_counted() -> None:
    master = Master(tasks=[Task(polls="abcd", period_ms=500)], writes={"W": 3000, "V": 9000})
    asked = master.run(120)
    found = find_lists(asked)
    assert found.between == {poll: sum(one.poll == poll for one in asked) for poll in ("W", "V")}


def test_a_missing_answer_costs_the_cycle_a_timeout_and_a_retry() -> None:
    master = Master(tasks=[Task(polls="abcd", pause_ms=200)], loss=0.02, retries=3, timeout_ms=400)
    (found,) = find_lists(master.run(200)).lists
    assert found.missing_cost_ns is not None
    assert found.missing_cost_ns / MS == pytest.approx(400, abs=10)
    assert find_lists(master.run(200)).timeout_ns == pytest.approx(400 * MS, rel=0.02)


def test_a_request_repeated_after_a_damaged_answer_is_in_its_cycle() -> None:
    master = Master(tasks=[Task(polls="abcd", pause_ms=200)], loss=0.1, retries=3, timeout_ms=400)
    asked = master.run(200)
    damaged = [
        one._replace(is_damaged=one.is_missing and at % 2 == 0) for at, one in enumerate(asked)
    ]
    assert any(one.is_damaged for one in damaged)
    (found,), (expected,) = find_lists(damaged).lists, find_lists(asked).lists
    assert found.cycles == expected.cycles
    assert [one.missing for one in found.steps] == [one.missing for one in expected.steps]


def test_a_dead_unit_says_how_long_it_keeps_the_master() -> None:
    master = Master(
        tasks=[Task(polls="abc", pause_ms=500)], dead=frozenset("b"), retries=2, timeout_ms=300
    )
    (found,) = find_lists(master.run(60)).lists
    a, b, c = found.steps
    assert (a.missing, b.missing, c.missing) == (0, found.cycles, 0)
    assert b.took_ns / MS == pytest.approx(900, rel=0.02)
    assert a.pause_ns / MS == pytest.approx(503, rel=0.02)
    assert found.whole_ns is None
    assert found.missing_cost_ns is None


def test_a_list_that_is_changed_gives_both_lists() -> None:
    before = Master(tasks=[Task(polls="abc", period_ms=1000)]).run(60)
    later = 60_000 * MS
    after = [
        Asked(one.poll, one.begin_ns + later, one.end_ns + later, one.is_missing)
        for one in Master(tasks=[Task(polls="def", period_ms=1000)]).run(60)
    ]
    assert sorted(lists_of(find_lists([*before, *after]))) == ["abc", "def"]


def test_the_order_in_which_requests_are_given_does_not_matter() -> None:
    asked = Master(tasks=[Task(polls="abcd", period_ms=500)], loss=0.05, retries=1).run(30)
    shuffled = asked.copy()
    Random(1).shuffle(shuffled)
    assert find_lists(shuffled) == find_lists(asked)


def test_requests_at_random_are_no_list() -> None:
    random = Random(1)
    at_ns, asked = START_NS, []
    for _ in range(500):
        at_ns += round(random.expovariate(1 / 500) * MS)
        asked.append(Asked(random.choice("abcdefgh"), at_ns, at_ns + MS, False))
    found = find_lists(asked)
    assert found.lists == ()
    assert sum(found.between.values()) == 500


def test_one_write_now_and_then_is_no_list() -> None:
    asked = Master(tasks=[Task(polls="a", period_ms=1000)], writes={"W": 5000}).run(600)
    assert lists_of(find_lists([one for one in asked if one.poll == "W"])) == []


def test_two_cycles_are_too_few() -> None:
    assert find_lists(Master(tasks=[Task(polls="abcd", period_ms=1000)]).run(0.9)).lists == ()


def test_nothing_asked_is_no_list() -> None:
    found: PollLists[str] = find_lists([])
    assert (found.lists, found.between, found.timeout_ns) == ((), {}, None)


def test_equal_times_and_times_that_run_backwards_do_no_harm() -> None:
    asked = [Asked("ab"[at % 2], START_NS, START_NS - at, False) for at in range(50)]
    assert sum(find_lists(asked).between.values()) in (0, 50)


@pytest.mark.parametrize("seed", SEEDS)
def test_a_long_list_is_found(seed: int) -> None:
    polls = [f"poll {at}" for at in range(150)]
    asked = Master(tasks=[Task(polls=polls, period_ms=5000)], loss=0.001).run(60, seed)
    (found,) = find_lists(asked).lists
    assert found.polls == polls


@pytest.mark.parametrize("lost", [0.02, 0.1])
def test_requests_that_the_capture_lost_do_not_hide_the_list(lost: float) -> None:
    random = Random(1)
    asked = Master(tasks=[Task(polls="abcdef", period_ms=500)]).run(120)
    kept = [one for one in asked if random.random() > lost]
    assert lists_of(find_lists(kept)) == ["abcdef"]
