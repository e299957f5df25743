"""The slaves of recordings."""

from __future__ import annotations

import pytest

from mbtool.core import UsageError
from mbtool.devices import Namer, parse_who
from mbtool.modbus.transaction import Outcome
from mbtool.workflows.shared.observed_slaves import MAX_SLAVES, ObservedSlaves
from tests.devices.transactions import transaction


def survey(
    *slaves: tuple[str | None, int], who: str | None = None, silent: int = 0
) -> ObservedSlaves:
    """A read of each slave; the units from 1 to `silent` do not answer."""
    found = ObservedSlaves(parse_who(who) if who is not None else None)
    found.add(
        Namer().name(
            transaction(
                3,
                0,
                quantity=1,
                destination=destination,
                unit=unit,
                outcome=Outcome.NO_ANSWER if unit <= silent else Outcome.OK,
            )
        )
        for destination, unit in slaves
    )
    return found


def named(found: ObservedSlaves) -> list[str]:
    return [str(one.who.at_any_port) for one in found.slaves]


def test_slaves_are_told_apart_by_where_they_are_and_their_unit() -> None:
    found = survey((None, 1), ("10.0.0.9:502", 1), ("10.0.0.9:502", 2), (None, 1))
    assert named(found) == ["1", "10.0.0.9/1", "10.0.0.9/2"]
    assert [one.transactions for one in found.slaves] == [2, 1, 1]


@pytest.mark.parametrize(
    ("who", "slaves"),
    [
        ("1", ["1", "10.0.0.9/1"]),
        ("10.0.0.9", ["10.0.0.9/1", "10.0.0.9/2"]),
        ("10.0.0.9/2", ["10.0.0.9/2"]),
    ],
)
def test_those_that_are_wanted_are_looked_at(who: str, slaves: list[str]) -> None:
    found = survey((None, 1), ("10.0.0.9:502", 1), ("10.0.0.9:502", 2), who=who)
    assert named(found) == slaves


def test_the_only_slave_is_the_one_that_is_meant() -> None:
    assert survey((None, 5)).only("--unit").unit == 5


def test_one_that_answers_is_meant_before_those_that_do_not() -> None:
    assert survey((None, 1), (None, 2), (None, 3), silent=2).only("--unit").unit == 3


def test_of_several_one_is_to_be_named() -> None:
    with pytest.raises(
        UsageError, match=r"2 slaves are there: 1 on line, 10\.0\.0\.9/2; name one with --unit"
    ):
        survey((None, 1), ("10.0.0.9:502", 2)).only("--unit")


def test_slaves_at_two_ports_of_an_address_are_named_with_them() -> None:
    both = ("10.0.0.9:502", 1), ("10.0.0.9:1502", 1)
    with pytest.raises(UsageError, match=r"10\.0\.0\.9:502/1, 10\.0\.0\.9:1502/1; name one"):
        survey(*both).only("--unit")
    assert survey(*both, who="10.0.0.9:1502/1").only("--unit").destination == "10.0.0.9:1502"


def test_where_there_is_none_that_is_said() -> None:
    with pytest.raises(
        UsageError, match="no transaction of such a slave is there; --unit chooses another"
    ):
        survey((None, 1), who="7").only("--unit")


def test_slaves_are_bounded_and_the_rest_is_counted() -> None:
    found = survey(*((f"10.0.{at >> 8}.{at & 255}:502", 1) for at in range(MAX_SLAVES + 3)))
    assert len(found.slaves) == MAX_SLAVES
    assert found.forgotten == 3
