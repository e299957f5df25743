"""What the charts of a page draw, as the chart library was told."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from mbtool.cli.main import run
from tests.views.report.browser import asked
from tests.workflows.evidence import capture_file

PLANT = Path(__file__).parents[3] / "captures" / "plant.pcap"
DRAWN = """
setTimeout(() => tell([...document.querySelectorAll("figure")].map((figure) => {
  const one = charts.find((chart) => figure.contains(chart.root));
  const scale = (key) => [one.scales[key].min, one.scales[key].max];
  return { title: figure.querySelector("b").textContent, time: one.scales.x.time, x: scale("x"),
    legend: [...figure.querySelectorAll(".legend button")].map((button) => button.textContent),
    data: one.data };
})), 3000);
"""

pytestmark = pytest.mark.peers


def drawn(capture: Path, folder: Path, *options: str) -> list[dict[str, Any]]:
    page = folder / "r.html"
    assert run(["report", str(capture), "-o", str(page), *options]) == 0
    told: list[dict[str, Any]] = asked(page, folder / "profile", DRAWN)
    return told


def test_charts_over_time_have_one_time_axis_and_no_series_that_never_happens(
    tmp_path: Path,
) -> None:
    charts = drawn(PLANT, tmp_path)
    over_time = [one["x"] for one in charts if one["time"]]
    assert len(over_time) > 3
    assert over_time == [over_time[0]] * len(over_time)
    titles = [one["title"] for one in charts]
    assert any(one.startswith("Exceptions over time") or "Failures" in one for one in titles)
    assert not any("wrong CRC" in one["legend"] for one in charts)


def test_a_steady_rate_is_steady_at_both_ends_of_the_capture(tmp_path: Path) -> None:
    capture = tmp_path / "well.pcap"
    capture.write_bytes(capture_file(60))
    (rate,) = [one for one in drawn(capture, tmp_path) if one["title"] == "Requests a second"]
    times, rates = rate["data"]
    assert len(times) > 3
    assert max(rates) < 1.3 * min(rates)
