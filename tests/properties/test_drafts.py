"""Drafts of profiles from traffic that others recorded."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from mbtool.core import MbtoolError, WireEvent
from mbtool.devices import Assignment, Assignments, Namer, Who, builtin_profiles, load_profile
from mbtool.devices.profile_match import match_profiles
from mbtool.modbus import Outcome
from mbtool.values.draft import draft_profile
from mbtool.workflows.shared.observed_slaves import ObservedSlaves
from mbtool.workflows.shared.reading import Reading, ReadingOptions

if TYPE_CHECKING:
    from pathlib import Path

    from mbtool.devices import NamedTransaction

MAX_BYTES = 400_000
MAX_SLAVES = 8


def records(path: Path) -> list[NamedTransaction]:
    try:
        all_ = list(Reading([str(path)], ReadingOptions()).records())
    except MbtoolError:
        return []  # A capture that is cut: test_truth.py reads what is whole of it.
    return [one for one in all_ if not isinstance(one, WireEvent)]


@pytest.fixture(scope="module")
def captures(public_captures: Path) -> list[Path]:
    found = sorted(public_captures.glob("*/*.pcap*"))
    return [path for path in found if path.suffix != ".csv" and path.stat().st_size < MAX_BYTES]


def test_every_slave_gives_a_draft_that_loads_and_allows_what_it_did(
    captures: list[Path], tmp_path: Path
) -> None:
    drafted = 0
    for path in captures:
        found = records(path)
        survey = ObservedSlaves(with_values=True)
        survey.add(found)
        for seen in survey.slaves[:MAX_SLAVES]:
            draft = draft_profile(seen, "draft", path.name)
            file = tmp_path / "draft.toml"
            file.write_text(draft.text, encoding="utf-8")
            assert load_profile(str(file)) == draft.profile, path
            namer = Namer(Assignments([Assignment(Who(), draft.profile)]))
            where = (seen.destination, seen.unit)
            own_records = [one for one in found if (one.destination, one.unit) == where]
            refused = {one.function for one in own_records if one.exception is not None}
            for one in own_records:
                findings = namer.name(one).findings
                own = [code for code in findings if code.startswith("DRAFT-")]
                # What it refused, once or always, is no part of its draft, and what the capture
                # lacks may have been refused.
                may_be_refused = one.function in refused or one.outcome is Outcome.NOT_CAPTURED
                was_done = one.outcome is Outcome.OK or not may_be_refused
                assert not own or not was_done, (path, one)
            drafted += 1
    assert drafted > len(captures) // 2


def test_every_slave_can_be_matched_and_scores_are_in_order(captures: list[Path]) -> None:
    profiles = [load_profile(name) for name in builtin_profiles()]
    for path in captures:
        survey = ObservedSlaves()
        survey.add(records(path))
        for seen in survey.slaves[:MAX_SLAVES]:
            verdict = match_profiles(seen, profiles)
            assert len(verdict.matches) == len(profiles)
            assert all(0 <= one.score <= 100 for one in verdict.matches), path
            assert verdict.sentence
