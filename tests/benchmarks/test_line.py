from __future__ import annotations

import json

import pytest

from tests.benchmarks.adapters import Column, Damage
from tests.benchmarks.line import HEADINGS, main, measure

SEED = 20


@pytest.mark.parametrize("column", Column)
def test_every_frame_of_an_undamaged_line_is_found(column: Column) -> None:
    one = measure(column, Damage.NONE, SEED, 300)
    assert (one.found, one.false, one.wrong) == (one.frames, 0, 0)


@pytest.mark.parametrize("damage", [one for one in Damage if one is not Damage.NONE])
@pytest.mark.parametrize("column", [Column.BYTES, Column.FTDI])
def test_damage_harms_what_it_hits_and_little_else(column: Column, damage: Damage) -> None:
    one = measure(column, damage, SEED, 1000)
    assert one.found_share >= 0.995
    assert one.false_per_10000 <= 1
    assert one.out_of_step_most <= 1


def test_the_same_arguments_give_the_same_counts() -> None:
    one, again = (measure(Column.FTDI, Damage.STRAY, SEED, 60) for _ in range(2))
    one.seconds = again.seconds = one.transaction_seconds = again.transaction_seconds = 0
    assert one == again


def test_the_table_has_a_line_for_each_cell(capsys: pytest.CaptureFixture[str]) -> None:
    main(["--transactions", "40", "--no-peers", "--cell", "burst/lost"])
    heading, *rows = capsys.readouterr().out.splitlines()
    assert heading.split("  ")[0] == HEADINGS[0]
    assert [one.split("  ")[1].strip() for one in rows] == ["bursts of 32", "bursts of 62"]


def test_json_has_a_line_for_each_cell(capsys: pytest.CaptureFixture[str]) -> None:
    main(["--transactions", "40", "--no-peers", "--cell", "/none", "--json"])
    rows = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert [one["adapter"] for one in rows] == list(Column)
    assert all(one["frames"] and 0 <= one["found_share"] <= 1 for one in rows)


def test_a_cell_that_does_not_exist_is_told(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        main(["--cell", "floppy"])
    assert "floppy" in capsys.readouterr().err
