from __future__ import annotations

from typing import Any

from mbtool.devices import PointValue
from mbtool.logs.messages import PointMessage
from mbtool.logs.points import PointChanges
from mbtool.modbus import Outcome
from tests.logs.samples import transaction


def test_a_point_is_returned_when_its_value_changes() -> None:
    changes = PointChanges()
    seen = [told(changes, value) for value in (1.0, 1.0, 2.0, 2.0, 1.0)]
    assert seen == [[1.0], [], [2.0], [], [1.0]]


def test_a_change_says_where_and_what() -> None:
    point = PointValue(name="level", reference="D10", value=2.5, text="2.5 m", unit="m")
    read = transaction(device="pump", points=[point])
    assert list(PointChanges().changes(read, 77)) == [
        PointMessage(
            ts_ns=77,
            link="rs485",
            unit_id=1,
            device="pump",
            name="level",
            reference="D10",
            value=2.5,
            text="2.5 m",
            unit="m",
        )
    ]


def test_the_same_name_elsewhere_is_another_point() -> None:
    changes = PointChanges()
    assert told(changes, 1.0) == [1.0]
    assert told(changes, 1.0, unit=2) == [1.0]
    assert told(changes, 1.0, link="other") == [1.0]
    assert told(changes, 1.0, device="other") == [1.0]
    assert told(changes, 1.0) == []


def test_a_write_that_the_device_refused_changes_no_point() -> None:
    changes = PointChanges()
    assert told(changes, 1.0, outcome=Outcome.EXCEPTION) == []
    assert told(changes, 1.0, outcome=Outcome.NO_ANSWER) == []
    assert told(changes, 1.0, outcome=Outcome.BROADCAST) == [1.0]


def test_the_number_of_points_is_bounded() -> None:
    changes = PointChanges(limit=2)
    for unit in (1, 2, 3):
        assert told(changes, 1.0, unit=unit) == [1.0]
    assert told(changes, 1.0, unit=3) == []
    assert told(changes, 1.0, unit=1) == [1.0]  # Forgotten, so it counts as changed.


def told(changes: PointChanges, value: float, **fields: Any) -> list[float | None]:
    point = PointValue(name="p", reference="p", value=value, text=str(value))
    read = transaction(points=[point], **fields)
    return [change.value for change in changes.changes(read, 0)]
