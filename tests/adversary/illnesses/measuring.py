"""Lets `check` judge recordings, and compares what it names with the truth."""

from __future__ import annotations

import json
from collections import Counter
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import dataclass
from io import StringIO
from typing import TYPE_CHECKING, Any

from mbtool.cli.main import run
from tests.adversary.illnesses.case import Case

if TYPE_CHECKING:
    from collections.abc import Iterable
    from pathlib import Path

    from tests.adversary.illnesses.case import Recording

ILLNESS = ("LINE-", "NET-")
"""Codes that name a cause; other codes tell what follows from it."""


@dataclass(frozen=True, slots=True)
class Verdict:
    """What was told of one case."""

    case: Case
    codes: tuple[str, ...]
    """Codes of the troubles, worst first; those of notes in parentheses."""
    is_named: bool
    wrong: tuple[str, ...]
    """Codes of other illnesses, which the recording does not have."""
    false_errors: tuple[str, ...]
    """Troubles of severity error against slaves that did what they should."""
    sentence: str


def judge(case: Case, folder: Path) -> Verdict:
    recording = case.write(folder / "recording")
    return verdict_of(case, recording, troubles_of(recording))


def verdict_of(case: Case, recording: Recording, told: list[dict[str, Any]]) -> Verdict:
    named = {one["code"] for one in told}
    wrong = tuple(
        one["code"]
        for one in told
        if one["code"].startswith(ILLNESS)
        and one["code"] not in {case.illness, *recording.also}
        and one["severity"] != "note"
    )
    if not case.illness:
        wrong = tuple(one["code"] for one in told if one["severity"] != "note")
    return Verdict(
        case,
        tuple(one["code"] if one["severity"] != "note" else f"({one['code']})" for one in told),
        not case.illness or case.illness in named,
        wrong,
        tuple(
            f"{one['code']} {one['unit']}"
            for one in told
            if one["severity"] == "error"
            and one["unit"] in recording.innocent
            and one["code"] not in {case.illness, *recording.also}
        ),
        told[0]["cause"] if told else "",
    )


def troubles_of(recording: Recording) -> list[dict[str, Any]]:
    """The troubles that `check` tells of a recording, worst first."""
    said = StringIO()
    with redirect_stdout(said), redirect_stderr(StringIO()):
        run(["check", *recording.arguments, "--format", "json"])
    troubles: list[dict[str, Any]] = json.loads(said.getvalue())["troubles"]
    return troubles


def table(verdicts: Iterable[Verdict]) -> str:
    counts: dict[str, Counter[str]] = {}
    for one in verdicts:
        row = counts.setdefault(one.case.illness or "healthy", Counter())
        row["cases"] += 1
        row["named" if one.is_named else "missed"] += 1
        row["wrong code"] += bool(one.wrong)
        row["false error"] += bool(one.false_errors)
    heads = ("cases", "named", "missed", "wrong code", "false error")
    total = sum(counts.values(), Counter())
    rows = [f"{'illness':20}" + "".join(f"{head:>13}" for head in heads)]
    rows += [
        f"{name:20}" + "".join(f"{row[head]:13}" for head in heads)
        for name, row in [*counts.items(), ("all", total)]
    ]
    return "\n".join(rows)
