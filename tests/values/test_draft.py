"""Drafts of profiles from traffic."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from hypothesis import given
from hypothesis import strategies as st

from mbtool.devices.assignment import Assignment, Assignments, Who
from mbtool.devices.loading import load_profile
from mbtool.devices.model import Access, Profile
from mbtool.devices.naming import Namer
from mbtool.devices.observed_slave import ObservedSlave
from mbtool.modbus.transaction import Outcome, Transaction
from mbtool.values.draft import MAX_POINTS, draft_profile
from tests.devices.transactions import transaction

if TYPE_CHECKING:
    from pathlib import Path


def seen(*transactions: Transaction) -> ObservedSlave:
    found = ObservedSlave("line", None, 5, with_values=True)
    for one in transactions:
        found.note(one)
    return found


def draft(*transactions: Transaction) -> Profile:
    return draft_profile(seen(*transactions), "draft", "site/capture.mcap").profile


def text(*transactions: Transaction) -> str:
    return draft_profile(seen(*transactions), "draft", "site/capture.mcap").text


def read(address: int, *values: int, **fields: Any) -> Transaction:
    return transaction(3, address, quantity=len(values), response_values=list(values), **fields)


def refused(function: int, address: int, quantity: int, exception: int) -> Transaction:
    return transaction(
        function, address, quantity=quantity, exception=exception, outcome=Outcome.EXCEPTION
    )


def test_accepted_addresses_are_joined_into_areas() -> None:
    profile = draft(read(10, 1, 2, 3), read(13, 4), read(20, 5), transaction(1, 0, quantity=8))
    assert [(area.name, area.first, area.last) for area in profile.areas] == [
        ("C0..7", 0, 7),
        ("HR10..13", 10, 13),
        ("HR20", 20, 20),
    ]
    assert {area.access for area in profile.areas} == {Access.READ}


def test_written_areas_are_writable_with_a_comment() -> None:
    written = transaction(16, 11, quantity=2, request_values=[7, 8])
    assert draft(read(10, 1, 2, 3), written).areas[0].access is Access.READ_WRITE
    assert "# Written here: 11..12.\n" in text(read(10, 1, 2, 3), written)
    assert "# Nobody wrote here; if the device allows it, access is rw.\n" in text(read(10, 1))


def test_refused_addresses_are_gaps_with_a_comment() -> None:
    parts = (read(10, 1, 2), refused(3, 12, 1, 2), read(13, 4))
    assert [(area.first, area.last) for area in draft(*parts).areas] == [(10, 11), (13, 13)]
    assert "# Refused beside it: holding 12 (exception 02).\n" in text(*parts)


def test_addresses_without_response_are_areas_of_their_own_with_a_comment() -> None:
    silent = transaction(3, 12, quantity=2, outcome=Outcome.NO_ANSWER)
    assert [(area.first, area.last) for area in draft(read(10, 1, 2), silent).areas] == [
        (10, 11),
        (12, 13),
    ]
    assert "# Asked for, but never answered: perhaps there is nothing here.\n" in text(silent)


def test_a_response_counts_more_than_a_missing_one() -> None:
    silent = transaction(3, 10, quantity=4, outcome=Outcome.NO_ANSWER)
    for parts in ((silent, read(10, 1, 2)), (read(10, 1, 2), silent)):
        assert [(area.first, area.last) for area in draft(*parts).areas] == [(10, 11), (12, 13)]


def test_a_function_that_was_refused_is_not_one_of_the_device() -> None:
    parts = (read(10, 1), refused(0x0F, 0, 3, 1))
    assert list(draft(*parts).functions) == ["03"]
    assert (
        "# 0F write multiple coils: answered 0 times, exception 01 illegal function 1 time, "
        "so not listed\n"
    ) in text(*parts)


def test_a_limit_is_drafted_only_if_more_was_refused() -> None:
    polled = [read(0, *range(100)), read(0, *range(20))]
    assert draft(*polled).functions["03"].limit is None
    wider = [*polled, read(100, *range(60)), refused(3, 0, 120, 3)]
    assert draft(*wider).functions["03"].limit == 100
    outside = [*polled, refused(3, 90, 20, 3)]
    assert draft(*outside).functions["03"].limit is None


def test_exceptions_are_those_seen() -> None:
    assert draft(read(10, 1), refused(3, 50, 1, 0x11)).exceptions.documented == [1, 2, 3, 0x11]


def test_points_are_called_by_their_addresses_with_the_reason_above() -> None:
    assert (
        "# Seen: 7 in all 2 answers.\n"
        "[[points]]\n"
        'name = "HR10"\n'
        'table = "holding_registers"\n'
        "address = 10\n"
    ) in text(read(10, 7), read(10, 7))
    assert (
        "# A guess, 99 % likely: as a float 230.1, of few digits; asked for as two registers.\n"
        '[[points]]\nname = "HR10"'
    ) in text(read(10, 0x4366, 0x199A))


def test_a_wide_request_counts_before_a_narrow_one() -> None:
    narrow, wide = read(1, 0x4366, 0x199A), read(0, 5, 0x4366, 0x199A, 0x4366, 0x1AE1)
    assert [(point.address, point.type) for point in draft(narrow, wide).points] == [
        (0, "uint16"),
        (1, "float32"),
        (3, "float32"),
    ]


def test_what_cannot_be_known_is_asked() -> None:
    counting = [read(10, 0, 60_000 + 7 * step, 3) for step in range(20)]
    assert "# To be asked: " in text(*counting)


def test_the_reported_name_is_the_title() -> None:
    found = seen(read(10, 1))
    found.identity |= {"vendor": "Maker", "product": "Pump 7"}
    profile = draft_profile(found, "draft", "x").profile
    assert (profile.title, profile.vendor) == ("Pump 7", "Maker")


def test_the_file_is_named_without_its_folder() -> None:
    assert "capture.mcap" in text(read(10, 1))
    assert "site" not in text(read(10, 1))


def test_the_number_of_points_is_bounded_with_a_comment() -> None:
    reads = [read(at, *range(100)) for at in range(0, MAX_POINTS + 100, 100)]
    assert len(draft(*reads).points) == MAX_POINTS
    assert f"# {100} more registers were seen" in text(*reads)


TRANSACTIONS = st.builds(
    lambda function, address, quantity, values, outcome, exception: transaction(
        function,
        address,
        quantity=quantity,
        request_values=values if function in (5, 6, 15, 16) else None,
        response_values=values if function in (1, 2, 3, 4) else None,
        outcome=outcome,
        exception=exception if outcome is Outcome.EXCEPTION else None,
    ),
    st.sampled_from([1, 2, 3, 4, 5, 6, 15, 16, 7, 0x41]),
    st.integers(0, 40) | st.integers(65_500, 65_535),
    st.integers(1, 12),
    st.lists(st.integers(0, 65_535), min_size=1, max_size=12),
    st.sampled_from(list(Outcome)),
    st.integers(1, 255),
)


@given(st.lists(TRANSACTIONS, min_size=1, max_size=12))
def test_any_traffic_gives_a_draft_that_loads_and_explains_it(
    tmp_path_factory: Any, parts: list[Transaction]
) -> None:
    drafted = draft_profile(seen(*parts), "draft", "x")
    path: Path = tmp_path_factory.mktemp("draft") / "draft.toml"
    path.write_text(drafted.text, encoding="utf-8")
    assert load_profile(str(path)) == drafted.profile
    namer = Namer(Assignments([Assignment(Who(), drafted.profile)]))
    refused = {one.function for one in parts if one.exception is not None}
    for one in parts:
        if (one.address or 0) + (one.quantity or 1) <= 1 << 16:
            own = [code for code in namer.name(one).findings if code.startswith("DRAFT-")]
            # What it refused, once or always, is no part of its draft.
            assert not own or (one.outcome is not Outcome.OK and one.function in refused)
