"""The transactions of a recording that is to be played."""

from __future__ import annotations

from typing import TYPE_CHECKING

from mbtool.core import CutError, InputError
from mbtool.workflows.shared.reading import ReadingOptions
from mbtool.workflows.shared.recorded import read_recorded
from tests.packets.building import pcap
from tests.workflows.evidence import captured

if TYPE_CHECKING:
    from pathlib import Path


def test_what_comes_before_a_cut_is_given_with_what_is_wanted(tmp_path: Path) -> None:
    path = tmp_path / "a.pcap"
    path.write_bytes(pcap(captured(3))[:-1])
    cuts: list[InputError] = []
    recorded = read_recorded(
        str(path), ReadingOptions(), lambda one: one.transaction_id != 1, cuts.append
    )
    assert [one.transaction_id for one in recorded.transactions] == [0, 2]
    assert [type(cut) for cut in cuts] == [CutError]
    assert recorded.assignments.profiles == []
