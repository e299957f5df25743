"""`check`, `stats`, `report` and `watch` tell an illness in the same sentence."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any

import pytest

from mbtool.cli.main import run
from mbtool.watching.watched import Watched
from mbtool.workflows.shared.reading import Reading, ReadingOptions
from tests.adversary.illnesses.measuring import troubles_of
from tests.adversary.illnesses.test_illnesses import sample
from tests.views.report.pages import Page

if TYPE_CHECKING:
    from pathlib import Path

    from tests.adversary.illnesses.case import Case

ONE_OF_EACH = {case.illness: case for case in sample() if case.illness}

CHECKED_ONLY = ("MB-", "RTU-", "TCP-", "SEC-")
"""Broken rules: `watch` does not check them when it judges."""


def sentences(troubles: list[dict[str, Any]]) -> list[tuple[str, str, str]]:
    return [(one["code"], one["cause"], one["remedy"]) for one in troubles]


@pytest.mark.parametrize("case", ONE_OF_EACH.values(), ids=str)
def test_all_commands_tell_an_illness_in_the_same_words(
    case: Case, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    recording = case.write(tmp_path / "line")
    told = sentences(troubles_of(recording))

    assert run(["stats", *recording.arguments, "--json"]) == 0
    assert sentences(json.loads(capsys.readouterr().out)["troubles"]) == told

    page = tmp_path / "page.html"
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
