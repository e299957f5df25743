"""The start of a profile."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest
from hypothesis import given
from hypothesis import strategies as st

from mbtool.devices.loading import load_profile
from mbtool.devices.point_types import PointType
from mbtool.devices.profile_template import name_for, starting_profile

if TYPE_CHECKING:
    from pathlib import Path


def test_the_template_loads(tmp_path: Path) -> None:
    path = tmp_path / "pump.toml"
    path.write_text(starting_profile("pump.toml", "pump"), encoding="utf-8")
    profile = load_profile(str(path))
    assert profile.name == "pump"
    assert {point.name for point in profile.points} >= {"Speed", "State", "Alarms", "Flow"}


def test_references_in_the_comments_are_correct(tmp_path: Path) -> None:
    path = tmp_path / "pump.toml"
    path.write_text(starting_profile("pump.toml", "pump"), encoding="utf-8")
    profile = load_profile(str(path))
    for point in profile.points:
        area = profile.area(point.table, point.address)
        assert area is not None
        if point.name in ("Speed", "Run"):
            assert area.reference(point.address) == {"Speed": "40011", "Run": "C1"}[point.name]


def test_it_shows_the_keys_that_most_profiles_need() -> None:
    text = starting_profile("pump.toml", "pump")
    common = [
        "name",
        "table",
        "address",
        "type",
        "count",
        "stride",
        "length",
        "access",
        "word_order",
        "unit",
        "scale",
        "offset",
        "decimals",
        "texts",
        "bits",
        "minimum",
        "maximum",
    ]
    assert {key for key in common if f"\n{key} = " not in text} == set()
    assert all(one in text for one in (PointType.FLOAT32, PointType.FLAGS, PointType.STRING))


def test_a_file_name_cannot_end_the_comment() -> None:
    assert "\nx = 1" not in starting_profile("a\nx = 1", "pump")


@pytest.mark.parametrize(
    ("file", "name"),
    [
        ("pump.toml", "pump"),
        ("maps/Pump 7.csv", "pump-7"),
        ("7.b.toml", "7.b"),
        ("ä.toml", "device"),
    ],
)
def test_the_name_is_made_from_the_file_name(file: str, name: str) -> None:
    assert name_for(file) == name


@given(st.text(max_size=30))
def test_any_file_gives_a_name_that_a_profile_may_have(file: str) -> None:
    name = name_for(file)
    assert name[0].isalnum()
    assert set(name) <= set("abcdefghijklmnopqrstuvwxyz0123456789._-")
