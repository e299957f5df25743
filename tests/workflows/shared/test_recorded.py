"""The transactions of a recording that is to be played."""

from __future__ import annotations

from typing import TYPE_CHECKING

from mbtool.workflows.shared.recorded import PlayOptions, read_recorded
from tests.packets.building import pcap
from tests.workflows.evidence import captured

if TYPE_CHECKING:
    from pathlib import Path


def test_what_comes_before_a_cut_is_given_with_what_is_wanted(tmp_path: Path) -> None:
    path = tmp_path / "a.pcap"
    path.write_bytes(pcap(captured(3))[:-1])
    remarks: list[str] = []
    options = PlayOptions(wanted=lambda one: one.transaction_id != 1)
    recorded = read_recorded(str(path), options, remarks.append)
    assert [one.transaction_id for one in recorded.transactions] == [0, 2]
    (remark,) = remarks
    assert remark.startswith(f"mbtool: {path}: ends in the middle of a record")
    assert remark.endswith("; playing what is there")
    assert recorded.assignments.profiles == []
