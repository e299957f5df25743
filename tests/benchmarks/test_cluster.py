from __future__ import annotations

from tests.benchmarks.cluster import ClusterMeasurement, report


def test_the_report_compares_with_the_first_line() -> None:
    measured = [ClusterMeasurement(1, 60.0, 55.0, 4000), ClusterMeasurement(2, 40.0, 58.0, 4000)]
    lines = report(measured).splitlines()
    assert lines[1].split() == ["1", "60.0", "55.0", "4,000", "1.00"]
    assert lines[2].split()[-1] == "1.50"
