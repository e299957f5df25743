"""`check` names a sample of the illnesses; `python -m tests.adversary.illnesses` tries all."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from tests.adversary.illnesses import lines, networks
from tests.adversary.illnesses.case import ALONE, MEDIUM, Case
from tests.adversary.illnesses.files import EXACT
from tests.adversary.illnesses.measuring import judge

if TYPE_CHECKING:
    from pathlib import Path

SEED = 1000


def sample() -> list[Case]:
    """Of each illness the medium case, alone and with exact times; and the healthy plants."""
    return [
        case
        for case in (*lines.cases(SEED), *networks.cases(SEED))
        if not case.illness or ((case.severity, case.beside, case.timing) == (MEDIUM, ALONE, EXACT))
    ]


@pytest.mark.parametrize("case", sample(), ids=str)
def test_an_illness_is_named_and_nobody_else_is_blamed(case: Case, tmp_path: Path) -> None:
    verdict = judge(case, tmp_path)
    assert verdict.is_named, verdict
    assert not verdict.wrong, verdict
    assert not verdict.false_errors, verdict
