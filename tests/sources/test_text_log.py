"""Modbus frames in the logs of other programs."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from mbtool.core import WireEvent
from mbtool.workflows.shared.reading import Reading, ReadingOptions
from tests.sources.text_logs import BY_WORD, FORMS, TIMED, conversation, expected

if TYPE_CHECKING:
    from pathlib import Path

    from mbtool.devices import NamedTransaction


def _read(path: Path) -> list[NamedTransaction]:
    reading = Reading([str(path)], ReadingOptions())
    return [one for one in reading.records() if not isinstance(one, WireEvent)]


def _told(records: list[NamedTransaction]) -> list[tuple[int, str]]:
    by_time = sorted(records, key=lambda one: one.start_ns)
    return [(one.function, str(one.outcome)) for one in by_time]


@pytest.mark.parametrize("transport", ["rtu", "tcp"])
@pytest.mark.parametrize("form", sorted(BY_WORD))
def test_each_form_gives_the_conversation(tmp_path: Path, form: str, transport: str) -> None:
    path = tmp_path / "log.txt"
    path.write_text(FORMS[form](conversation(transport)))
    told = _told(_read(path))
    if transport == "tcp" and form not in TIMED:
        # Requests on TCP may overtake each other, so without times the response may come later.
        told = [
            (function, outcome.replace("not-captured", "no-answer")) for function, outcome in told
        ]
    assert told == expected()


@pytest.mark.parametrize("form", sorted(set(FORMS) - BY_WORD))
def test_a_stream_of_rtu_needs_no_word(tmp_path: Path, form: str) -> None:
    path = tmp_path / "log.txt"
    path.write_text(FORMS[form](conversation()))
    assert _told(_read(path)) == expected()


@pytest.mark.parametrize("form", sorted(TIMED))
def test_latency_is_the_time_between_two_lines(tmp_path: Path, form: str) -> None:
    path = tmp_path / "log.txt"
    path.write_text(FORMS[form](conversation()))
    latencies = {one.latency_ns for one in _read(path) if one.latency_ns is not None}
    in_seconds = form in ("esphome", "go_client", "gateway", "syslog", "powershell")
    assert latencies == {0 if in_seconds else 57_000_000}


@pytest.mark.parametrize("form", sorted(set(FORMS) - TIMED))
def test_without_times_there_is_no_latency(tmp_path: Path, form: str) -> None:
    path = tmp_path / "log.txt"
    path.write_text(FORMS[form](conversation()))
    assert {one.latency_ns for one in _read(path)} == {None}
