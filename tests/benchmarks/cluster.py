"""Compares one worker of a Dask cluster with several: python -m tests.benchmarks.cluster.

Makes rotated captures of some sites, decodes them into Parquet by one worker and by several, and
prints how long each took by the clock, and the processor time of the workers. Absolute figures are
the machine's; on a busy machine the clock tells little.
"""

from __future__ import annotations

import argparse
import logging
import os
import resource
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from mbtool.workflows.decode_job import DecodeJob, JobOptions, dask_cluster
from tests.workflows.rotated import make_sites

if TYPE_CHECKING:
    from collections.abc import Sequence

PACKETS = 500_000
"""Packets of each site."""


@dataclass(frozen=True, slots=True)
class ClusterMeasurement:
    """What a job took with some workers."""

    workers: int
    seconds: float
    """By the clock, without the start of the cluster."""
    processor_s: float
    """Processor time of all workers."""
    transactions: int


def measure(
    folder: Path, sites: int, packets: int, workers: Sequence[int]
) -> list[ClusterMeasurement]:
    """Decode the same captures by each of these numbers of workers."""
    make_sites(folder / "in", sites, packets)
    return [_measured(folder, count) for count in workers]


def _measured(folder: Path, workers: int) -> ClusterMeasurement:
    from distributed import Client, LocalCluster

    with (
        LocalCluster(
            n_workers=workers,
            threads_per_worker=1,
            dashboard_address=None,
            silence_logs=logging.CRITICAL,
        ) as cluster,
        Client(cluster, set_as_default=False) as client,
    ):
        client.run(_imported)
        before = sum(client.run(_processor_s).values())
        begun = time.monotonic()
        job = DecodeJob(
            [str(folder / "in" / "*" / "*" / "*")], str(folder / f"out-{workers}"), JobOptions()
        )
        outcomes = list(job.run(dask_cluster(cluster.scheduler_address)))
        seconds = time.monotonic() - begun
        used = sum(client.run(_processor_s).values()) - before
    assert not any(one.error for one in outcomes)
    return ClusterMeasurement(workers, seconds, used, sum(one.transactions for one in outcomes))


def _imported() -> None:
    import mbtool.workflows.decode_run  # noqa: F401


def _processor_s() -> float:
    used = resource.getrusage(resource.RUSAGE_SELF)
    return used.ru_utime + used.ru_stime


def report(measured: Sequence[ClusterMeasurement]) -> str:
    """A line for each number of workers."""
    lines = [f"{'workers':>8}{'s':>8}{'processor s':>13}{'transactions':>14}{'times one':>11}"]
    lines += [
        f"{one.workers:>8}{one.seconds:>8.1f}{one.processor_s:>13.1f}{one.transactions:>14,}"
        f"{measured[0].seconds / one.seconds:>11.2f}"
        for one in measured
    ]
    return "\n".join(lines) + "\n"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--sites", type=int, default=8, help="sites, each of 10 files")
    parser.add_argument("--packets", type=int, default=PACKETS, help="packets of each site")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        measured = measure(Path(folder), options.sites, options.packets, (1, 2))
    load = ", ".join(f"{one:.1f}" for one in os.getloadavg())
    sys.stdout.write(f"{os.cpu_count()} cores, load {load}\n{report(measured)}")


if __name__ == "__main__":
    main()
