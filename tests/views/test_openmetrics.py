"""The metrics for Prometheus."""

from __future__ import annotations

from pathlib import Path

from mbtool.views.openmetrics import openmetrics
from mbtool.workflows.check import CheckRun
from mbtool.workflows.shared.reading import ReadingOptions

CAPTURES = Path(__file__).resolve().parents[2] / "captures"


def metrics(name: str) -> list[str]:
    run = CheckRun([str(CAPTURES / name)], ReadingOptions())
    for _ in run.findings():
        pass
    return openmetrics(run.judgement()).splitlines()


def test_transactions_latencies_and_troubles_are_counted() -> None:
    lines = metrics("plant.pcap")
    labels = 'link="10.0.0.12",unit="2",function="04"'
    assert f'mbtool_transactions_total{{{labels},outcome="ok"}} 19' in lines
    assert f'mbtool_transactions_total{{{labels},outcome="no-answer"}} 1' in lines
    assert f"mbtool_latency_seconds_count{{{labels}}} 19" in lines
    assert (
        'mbtool_trouble{code="UNIT-SLOW",severity="warning",link="10.0.0.12",unit="2",master=""} 1'
        in lines
    )
    assert lines[-1] == "# EOF"


def test_each_sample_stands_below_its_family_once() -> None:
    lines = metrics("plant.pcap")
    family = ""
    for line in lines[:-1]:
        if line.startswith("# TYPE"):
            family = line.split()[2]
        elif not line.startswith("#"):
            assert line.startswith(family)
    samples = [line.rpartition(" ")[0] for line in lines if not line.startswith("#")]
    assert len(samples) == len(set(samples))


def test_a_serial_line_has_its_load() -> None:
    (busy,) = (one for one in metrics("ft1a-touch-line.mcap") if "busy_ratio{" in one)
    assert busy.startswith('mbtool_bus_busy_ratio{link="rs485"} 0.')
