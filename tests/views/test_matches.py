"""What matching says, as a table and for programs."""

from __future__ import annotations

import io

from rich.console import Console

from mbtool.devices import load_profile
from mbtool.devices.observed_slave import ObservedSlave
from mbtool.devices.profile_match import MatchResult, match_profiles
from mbtool.modbus.transaction import Outcome, Transaction
from mbtool.views.matches import (
    MAX_DETAILED,
    MIN_SHOWN,
    match_record,
    print_match_results,
    shown_matches,
)
from tests.devices.transactions import transaction

NAMES = ("fa3-at1m8x", "fa3-at1m8y", "fa3-th1m16y", "idec-ft1a-touch")


def verdict(*transactions: Transaction, link: str = "rs485") -> MatchResult:
    seen = ObservedSlave(link, None, 5)
    for one in transactions:
        seen.note(one)
    return match_profiles(seen, [load_profile(name) for name in NAMES])


def printed(*verdicts: MatchResult) -> str:
    out = io.StringIO()
    print_match_results(Console(file=out, width=100), verdicts)
    return out.getvalue()


READ = transaction(3, 0, quantity=2, response_values=[1, 2])


def test_a_slave_has_its_sentence_and_its_profiles_with_what_speaks_for_and_against() -> None:
    lines = [line.rstrip() for line in printed(verdict(READ)).splitlines()]
    assert lines[:4] == [
        "unit 5 at rs485: explained best by idec-ft1a-touch, though no refusal, model code or name "
        "confirms",
        "it",
        "profile          score  why",
        "idec-ft1a-touch     90  + the one request ended as it says",
    ]
    assert "- it speaks tcp, and this is rtu" in printed(verdict(READ))


def test_a_slave_that_never_answered_has_its_sentence_only() -> None:
    silent = verdict(transaction(3, 0, quantity=1, outcome=Outcome.NO_ANSWER))
    assert printed(silent) == "unit 5 at rs485: never answered, so nothing tells what it is\n"


def test_only_the_best_are_shown() -> None:
    assert len(shown_matches(verdict(READ))) == MIN_SHOWN


def test_nothing_of_a_name_is_obeyed() -> None:
    assert "\x1b" not in printed(verdict(READ, link="[red]\x1b[31m"))
    assert "[red]" in printed(verdict(READ, link="[red]\x1b[31m"))


def test_a_program_gets_all_of_it() -> None:
    record = match_record(verdict(READ))
    assert record["unit"] == 5
    assert record["link"] == "rs485"
    assert "destination" not in record
    assert record["best"] == ["idec-ft1a-touch"]
    assert {one["profile"] for one in record["profiles"]} == set(NAMES)
    assert record["profiles"][0]["score"] == 90


def test_of_many_slaves_there_is_a_summary() -> None:
    silent = transaction(3, 0, quantity=1, outcome=Outcome.NO_ANSWER)
    many = [verdict(silent, link=f"line{number}") for number in range(MAX_DETAILED)]
    lines = [line.rstrip() for line in printed(verdict(READ), *many).splitlines()]
    assert lines == [
        f"{MAX_DETAILED} slaves: never answered, so nothing tells what it is",
        "  unit 5 at line0, unit 5 at line1, unit 5 at line2 and so on",
        "1 slave: explained best by idec-ft1a-touch, though no refusal, model code or name "
        "confirms it",
        "  unit 5 at rs485",
        "--format jsonl tells each slave with its profiles",
    ]
