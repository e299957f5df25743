from __future__ import annotations

import random

import pytest

from mbtool.devices.checking.sliding_window import LruDict


def test_a_missing_entry_is_made_once() -> None:
    kept: LruDict[str, list[int]] = LruDict(list)
    kept["a"].append(1)
    assert kept["a"] == [1]
    assert "b" not in kept
    assert kept.get("b") is None
    assert list(kept.items()) == [("a", [1])]


def test_the_least_recently_used_entry_is_removed() -> None:
    kept: LruDict[str, list[int]] = LruDict(list, limit=2)
    kept["a"].append(1)
    kept["b"].append(2)
    kept["a"].append(3)
    kept["c"].append(4)
    assert dict(kept.items()) == {"a": [1, 3], "c": [4]}
    assert len(kept) == 2


def test_a_removed_entry_is_made_again() -> None:
    kept: LruDict[str, list[int]] = LruDict(list)
    kept["a"].append(1)
    assert kept.pop("a") == [1]
    assert kept.pop("a") is None
    kept["a"].append(2)
    kept.clear()
    assert list(kept.values()) == []


@pytest.mark.parametrize("number", range(20))
def test_many_keys_used_together_leave_the_same_entries_as_one_by_one(number: int) -> None:
    rng = random.Random(number)
    limit = rng.randrange(1, 12)
    together: LruDict[int, list[int]] = LruDict(list, limit=limit)
    singly: LruDict[int, list[int]] = LruDict(list, limit=limit)
    uses = 0
    for _ in range(6):
        keys = [rng.randrange(rng.choice((4, 20))) for _ in range(rng.randrange(40))]
        for value, places in together.use(keys):
            value += [uses + place for place in places]
        for place, key in enumerate(keys):
            singly[key].append(uses + place)
        uses += len(keys)
        assert list(together.items()) == list(singly.items())
    assert uses > 20
