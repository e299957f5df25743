from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from mbtool.core import UsageError
from mbtool.devices import assignment as module
from mbtool.devices.assignment import Assignments, Who, parse_assignment, parse_who
from mbtool.devices.loading import load_profile
from mbtool.modbus.adu import Transport
from tests.devices.transactions import transaction

if TYPE_CHECKING:
    from pathlib import Path


@pytest.mark.parametrize(
    ("text", "who"),
    [
        ("5", Who(unit=5)),
        ("0", Who(unit=0)),
        ("192.168.3.250", Who("192.168.3.250")),
        ("192.168.3.250:1502", Who("192.168.3.250", 1502)),
        ("192.168.3.250/5", Who("192.168.3.250", None, 5)),
        ("192.168.3.250:1502/5", Who("192.168.3.250", 1502, 5)),
        ("[::1]:502/255", Who("::1", 502, 255)),
        ("[2001:DB8::0:1]", Who("2001:db8::1")),
        ("::1", Who("::1")),
        ("all", Who()),
    ],
)
def test_reads_who(text: str, who: Who) -> None:
    assert parse_who(text) == who
    assert parse_who(str(who)) == who


@pytest.mark.parametrize(
    "text",
    ["256", "-1", "plc", "192.168.3.256", "192.168.3.250:", "192.168.3.250:65536", "192.168.3.250/",
     "192.168.3.250/256", "[::1", "1.2.3.4:5:6", "ALL", "²", "9" * 5000, ""],
)  # fmt: skip
def test_invalid_who_is_refused_with_examples(text: str) -> None:
    with pytest.raises(UsageError, match=r"WHO is 5, 192\.168\.3\.250"):
        parse_who(text)


def test_reads_an_assignment_and_its_profile() -> None:
    assignment = parse_assignment("192.168.3.250/5=fa3-at1m8x")
    assert assignment.who == Who("192.168.3.250", None, 5)
    assert assignment.profile is load_profile("fa3-at1m8x")


def test_path_may_hold_an_equals_sign(tmp_path: Path) -> None:
    path = tmp_path / "a=b.toml"
    path.write_text('extends = "fa3-at1m8x"\nname = "mine"', encoding="utf-8")
    assert parse_assignment(f"5={path}").profile.name == "mine"


@pytest.mark.parametrize("text", ["5", "=fa3-at1m8x", "5=", ""])
def test_assignment_without_a_part_is_refused(text: str) -> None:
    with pytest.raises(UsageError, match="write WHO=PROFILE"):
        parse_assignment(text)


def _assignments(*texts: str) -> Assignments:
    return Assignments(parse_assignment(text) for text in texts)


def _profile_name(assignments: Assignments, destination: str | None, unit: int) -> str | None:
    profile = assignments.profile_for(transaction(3, 0, destination=destination, unit=unit))
    return profile.name if profile is not None else None


def test_the_most_specific_assignment_applies_in_any_order() -> None:
    texts = [
        "all=fa3-th1m16xc",
        "5=idec-ft1a-touch",
        "10.0.0.9=fa3-th1m16y",
        "10.0.0.9:1502=fa3-th1m16ye",
        "10.0.0.9/5=fa3-at1m8x",
        "10.0.0.9:1502/5=fa3-at1m8y",
    ]
    for assignments in (_assignments(*texts), _assignments(*reversed(texts))):
        assert _profile_name(assignments, None, 1) == "fa3-th1m16xc"
        assert _profile_name(assignments, None, 5) == "idec-ft1a-touch"
        assert _profile_name(assignments, "10.0.0.8:502", 5) == "idec-ft1a-touch"
        assert _profile_name(assignments, "10.0.0.9:502", 1) == "fa3-th1m16y"
        assert _profile_name(assignments, "10.0.0.9:1502", 1) == "fa3-th1m16ye"
        assert _profile_name(assignments, "10.0.0.9:502", 5) == "fa3-at1m8x"
        assert _profile_name(assignments, "10.0.0.9:1502", 5) == "fa3-at1m8y"


def test_ipv6_addresses_match_in_any_spelling() -> None:
    assignments = _assignments("[2001:DB8:0::1]=fa3-at1m8x")
    assert _profile_name(assignments, "[2001:db8::1]:502", 1) == "fa3-at1m8x"


def test_a_slave_without_an_assignment_has_no_profile() -> None:
    assert _profile_name(_assignments("5=fa3-at1m8x"), None, 6) is None
    assert _profile_name(Assignments(), "10.0.0.9:502", 6) is None


def test_one_who_with_two_profiles_is_refused() -> None:
    with pytest.raises(UsageError, match="'5' is given two profiles, fa3-at1m8x and fa3-at1m8y"):
        _assignments("5=fa3-at1m8x", "5=fa3-at1m8y")


def test_profiles_in_use_are_listed_once() -> None:
    assignments = _assignments("5=fa3-at1m8x", "6=fa3-at1m8x", "7=fa3-at1m8y")
    assert sorted(profile.name for profile in assignments.profiles) == ["fa3-at1m8x", "fa3-at1m8y"]


def test_memory_is_bounded() -> None:
    assignments = _assignments("all=fa3-at1m8x")
    for port in range(3 * module._MAX_CACHED):
        assert _profile_name(assignments, f"10.0.0.9:{port}", 1) == "fa3-at1m8x"
    assert len(assignments._cache) <= module._MAX_CACHED


def test_on_an_ascii_line_a_profile_has_the_limits_of_that_mode() -> None:
    assignments = _assignments("2=chino-lt830", "3=fa3-at1m8x")
    limits = {}
    for mode in (Transport.RTU, Transport.ASCII):
        profile = assignments.profile_for(transaction(3, unit=2, transport=mode))
        assert profile is not None
        assert profile is assignments.profile_for(transaction(4, unit=2, transport=mode))
        rule = profile.rule(3)
        assert rule is not None
        limits[mode] = rule.limit
    assert limits == {Transport.RTU: 26, Transport.ASCII: 13}
    other = assignments.profile_for(transaction(3, unit=3, transport=Transport.ASCII))
    assert other is load_profile("fa3-at1m8x")


def test_the_profiles_at_an_endpoint_are_those_of_all_its_units() -> None:
    assigned = Assignments(
        parse_assignment(one)
        for one in ("10.0.0.2/5=wago-750", "10.0.0.2:503=fa3-at1m8x", "7=idec-ft1a-touch")
    )
    names = [one.name for one in assigned.profiles_at("10.0.0.2:502")]
    assert names == ["wago-750", "idec-ft1a-touch"]
    assert len(assigned.profiles_at("10.0.0.2:503")) == 3
    assert [one.name for one in assigned.profiles_at("10.0.0.9:502")] == ["idec-ft1a-touch"]
    assert [one.name for one in assigned.profiles_at("")] == ["idec-ft1a-touch"]
