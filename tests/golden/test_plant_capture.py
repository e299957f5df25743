"""captures/plant.pcap is what its script makes."""

from __future__ import annotations

from pathlib import Path

from tests.golden.plant_capture import plant

CAPTURE = Path(__file__).resolve().parents[2] / "captures" / "plant.pcap"


def test_the_capture_of_a_plant_is_made_by_its_script() -> None:
    assert CAPTURE.read_bytes() == plant()
