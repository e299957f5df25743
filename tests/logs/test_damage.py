from __future__ import annotations

from mbtool.core import CutError, DamageError, EventKind
from mbtool.logs.damage import Damage


def _at(offset: int) -> DamageError:
    return DamageError(f"x.mcap: damaged at byte {offset}: a chunk whose CRC does not match")


def test_no_damage_is_false_and_has_no_hole() -> None:
    damage = Damage("x.mcap")
    assert not damage
    assert damage.take_gap(1) == []


def test_one_damaged_place_is_reported_with_the_skipped_bytes() -> None:
    damage = Damage("x.mcap")
    damage.add(_at(530), 812)
    assert damage
    assert str(damage.error()) == (
        "x.mcap: damaged at byte 530: a chunk whose CRC does not match; "
        "812 bytes of the log are left out, all else was read; "
        "mbtool recover makes a whole log of it"
    )
    assert damage.take_gap(1) == []


def test_damage_without_skipped_bytes_is_reported_alone() -> None:
    damage = Damage("x.mcap")
    damage.add(_at(530))
    assert str(damage.error()) == f"{_at(530)}; mbtool recover makes a whole log of it"


def test_further_places_are_counted() -> None:
    damage = Damage("x.mcap")
    damage.add(_at(1), 10)
    damage.add_hole(_at(2), 2, 20)
    assert ", and at 1 more place; 30 bytes of the log" in str(damage.error())
    damage.add_hole(_at(3), 3, 30)
    assert ", and at 2 more places; 60 bytes of the log" in str(damage.error())


def test_a_gap_is_reported_once_with_the_given_time() -> None:
    damage = Damage("x.mcap")
    damage.add_hole(_at(20), 20, 100)
    damage.add_hole(_at(130), 130, 50)
    (hole,) = damage.take_gap(7)
    assert (hole.ts_ns, hole.link, hole.kind) == (7, "", EventKind.GAP)
    assert hole.message == "150 bytes of the log, from byte 20 on, are damaged and left out"
    assert damage.take_gap(8) == []


def test_a_hole_with_nothing_around_it_is_kept_for_the_first_item_with_a_time() -> None:
    damage = Damage("x.mcap")
    damage.add_hole(_at(20), 20, 100)
    assert damage.take_gap(0) == []
    assert [hole.ts_ns for hole in damage.take_gap(7)] == [7]


def test_another_error_at_the_end_is_reported_with_the_damage_before_it() -> None:
    damage = Damage("x.mcap")
    damage.add(_at(20), 100)
    end = damage.added_to(CutError("x.mcap: cut off at byte 900"))
    assert isinstance(end, CutError)
    assert str(end) == (
        "x.mcap: cut off at byte 900; before that, damaged at byte 20: "
        "a chunk whose CRC does not match; 100 bytes of the log are left out"
    )
