"""Holds every capture made by others against its truth."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from tests.captures import FOLDER, public_folder
from tests.differential.truth import captures_with_truth, compare, explanations, main

if TYPE_CHECKING:
    from pathlib import Path

COMPLETE = frozenset(
    {
        "testing__traces__modbus_example.pcap",
        "modbus__tcp__manual-test-capture.pcapng",
        "modbus.pcap",  # of nDPI, go-dpi-packet and others
        "Modbus__modbus_test.pcap",
        "modbus_test_data_part1.pcap",
        "modbus_test_data_part2.pcap",
        "channel_4d_12s.pcap",
        "modbusSmall.pcap",
        "tests__inspectors__modbus__modbus_w_pafs.pcap",
        "reseg5_suricata.pcap",
        "reseg9_nopnop.pcap",
        "vlan_icsnpp_example.pcap",
        "sll2_ndpi.pcap",
        "loop108_plc4x.pcap",
        "ipv6_iti_modbus_test.pcap",
        "us_be_zeeksmall.pcap",
        "gz_eit.pcap.gz",
        "multi_if_open.pcapng",
        "port10502_stepping0.pcap",
    }
)
"""Captures that must agree without any explanation."""


@pytest.mark.public_captures
def test_every_capture_agrees_with_its_truth_or_differs_as_explained(
    public_captures: Path,
) -> None:
    explained = explanations()
    seen = set()
    for path in captures_with_truth(public_captures):
        result = compare(path)
        seen.add(path.name)
        expected = explained.get(path.name)
        figures = (len(result.missing), result.extra)
        assert figures == (expected.figures if expected else (0, 0)), (
            f"{path.name}: {result.missing[:3]} missing, {result.extra} extra"
        )
    assert seen >= COMPLETE
    assert set(explained) <= seen - COMPLETE, "an explanation that nothing needs"


@pytest.mark.public_captures
def test_adus_whose_pieces_have_less_than_eight_bytes_are_found(public_captures: Path) -> None:
    by_name = {path.name: path for path in captures_with_truth(public_captures)}
    assert compare(by_name["reseg5_suricata.pcap"]).found == 39
    assert compare(by_name["reseg9_nopnop.pcap"]).found == 467


@pytest.mark.public_captures
def test_a_cut_file_gives_every_adu_of_its_whole_packets(public_captures: Path) -> None:
    by_name = {path.name: path for path in captures_with_truth(public_captures)}
    result = compare(by_name["cutfile_nopnop.pcap"])
    assert result.agrees
    assert "ends in the middle of a record" in result.cut


def test_a_folder_without_captures_is_told(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(FOLDER, str(tmp_path))
    assert main(public_folder()) == 3
    assert str(tmp_path) in capsys.readouterr().err
