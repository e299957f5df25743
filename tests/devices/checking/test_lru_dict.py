from __future__ import annotations

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
