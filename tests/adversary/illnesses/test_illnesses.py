"""`check` names a sample of the illnesses; `stats`, `report` and `watch` tell them in its words.

`python -m tests.adversary.illnesses` tries all.
"""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any

import pytest

from mbtool.cli.main import run
from mbtool.watching.watched import Watched
from mbtool.workflows.shared.reading import Reading, ReadingOptions
from tests.adversary.illnesses import lines, networks
from tests.adversary.illnesses.case import ALONE, MEDIUM, Case, Recording
from tests.adversary.illnesses.files import EXACT
from tests.adversary.illnesses.measuring import troubles_of, verdict_of
from tests.views.report.pages import Page

if TYPE_CHECKING:
    from pathlib import Path

SEED = 1000
SHORT_S = 60
"""So long a recording (s) of a line shows each of these illnesses."""
CHECKED_ONLY = ("MB-", "RTU-", "TCP-", "SEC-")
"""Broken rules: `watch` does not check them when it judges."""


SAMPLE = [
    case
    for case in (*lines.cases(SEED, SHORT_S), *networks.cases(SEED))
    if not case.illness or ((case.severity, case.beside, case.timing) == (MEDIUM, ALONE, EXACT))
]
"""Of each illness the medium case, alone and with exact times; and the healthy plants."""
ONE_OF_EACH = {case.illness: case for case in SAMPLE if case.illness}.values()


@pytest.mark.parametrize("case", SAMPLE, ids=str)
def test_an_illness_is_named_by_all_commands_and_nobody_else_is_blamed(
    case: Case, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    recording = case.write(tmp_path / "recording")
    told = troubles_of(recording)
    verdict = verdict_of(case, recording, told)
    assert verdict.is_named, verdict
    assert not verdict.wrong, verdict
    assert not verdict.false_errors, verdict
    if case in ONE_OF_EACH:
        in_the_same_words(recording, sentences(told), tmp_path / "page.html", capsys)


def sentences(troubles: list[dict[str, Any]]) -> list[tuple[str, str, str]]:
    return [(one["code"], one["cause"], one["remedy"]) for one in troubles]


def in_the_same_words(
    recording: Recording,
    told: list[tuple[str, str, str]],
    page: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert run(["stats", *recording.arguments, "--json"]) == 0
    assert sentences(json.loads(capsys.readouterr().out)["troubles"]) == told

    assert run(["report", *recording.arguments, "-o", str(page)]) == 0
    document = Page(page.read_text(encoding="utf-8")).document
    assert [one["text"] for one in document["verdict"]["troubles"]] == [
        f"{cause}: {remedy}" + ("" if f"({code}" in cause else f" ({code})")
        for code, cause, remedy in told
    ]

    if len(recording.arguments) == 1:
        assert of_watch(recording.arguments[0]) == [
            one for one in told if not one[0].startswith(CHECKED_ONLY)
        ]


def of_watch(path: str) -> list[tuple[str, str, str]]:
    reading = Reading([path], ReadingOptions())
    watched = Watched(reading.format_of)
    for record in reading.records():
        watched.add(record)
    watched.advance(None)
    troubles = watched.judge().troubles
    return [
        (one.code, one.cause, one.remedy)
        for one in troubles
        if not one.code.startswith(CHECKED_ONLY)
    ]
