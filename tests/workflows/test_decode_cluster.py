"""decode of many captures by a Dask cluster, on a disk and in an object store."""

from __future__ import annotations

import logging
import os
import signal
from typing import TYPE_CHECKING, Any

import pyarrow.dataset as ds
import pytest
from pyarrow import fs

from mbtool.cluster.store import OutputStore, list_inputs
from mbtool.core import InputError, LinkError
from mbtool.workflows.decode_job import DecodeJob, JobOptions, dask_cluster, local_processes
from tests.workflows.rotated import make_sites, rows_alone

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

distributed = pytest.importorskip("distributed", reason="needs mbtool[cluster]")


@pytest.fixture(scope="module")
def object_store() -> Iterator[fs.S3FileSystem]:
    """An object store on this machine, with a bucket `plants`."""
    server_module = pytest.importorskip("moto.server", reason="pip install moto flask flask-cors")
    server = server_module.ThreadedMotoServer("127.0.0.1", 0, verbose=False)
    server.start()
    host, port = server.get_host_and_port()
    with pytest.MonkeyPatch.context() as patched:
        patched.setenv("AWS_ENDPOINT_URL", f"http://{host}:{port}")
        patched.setenv("AWS_ACCESS_KEY_ID", "any")
        patched.setenv("AWS_SECRET_ACCESS_KEY", "any")
        store = fs.S3FileSystem(
            endpoint_override=f"http://{host}:{port}",
            region="us-east-1",
            allow_bucket_creation=True,
        )
        store.create_dir("plants")
        yield store
    server.stop()


@pytest.fixture(scope="module")
def cluster(object_store: fs.S3FileSystem) -> Iterator[Any]:
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, dashboard_address=None, silence_logs=logging.CRITICAL
    ) as started:
        yield started


def rows_in(folder: str, store: fs.FileSystem | None = None) -> list[str]:
    table = ds.dataset(folder, format="parquet", filesystem=store).to_table()
    return sorted(map(repr, table.to_pylist()))


def test_a_cluster_gives_the_rows_of_one_process_also_if_a_worker_is_killed(
    tmp_path: Path, cluster: Any
) -> None:
    paths = make_sites(tmp_path / "in", 4, 300)
    job = DecodeJob([str(tmp_path / "in/*/*/*")], str(tmp_path / "out"), JobOptions())
    outcomes = job.run(dask_cluster(cluster.scheduler_address))
    first = next(outcomes)
    with distributed.Client(cluster, set_as_default=False) as client:
        os.kill(min(client.run(os.getpid).values()), signal.SIGKILL)
    assert [one.error for one in [first, *outcomes]] == [""] * 40
    assert rows_in(str(tmp_path / "out")) == rows_alone(paths)
    again = DecodeJob([str(tmp_path / "in/*/*/*")], str(tmp_path / "out"), JobOptions())
    assert [*again.run(dask_cluster(cluster.scheduler_address))] == []
    assert again.done_before == 40


def test_captures_of_an_object_store_give_the_rows_of_one_process(
    tmp_path: Path, cluster: Any, object_store: fs.S3FileSystem
) -> None:
    paths = make_sites(tmp_path / "in", 4, 300)
    fs.copy_files(str(tmp_path / "in"), "plants/in", destination_filesystem=object_store)
    pattern = "s3://plants/in/site-*/2026-*/*.pcap"
    outcomes = [
        *DecodeJob([pattern], "s3://plants/out", JobOptions()).run(
            dask_cluster(cluster.scheduler_address)
        )
    ]
    assert [one.error for one in outcomes] == [""] * 40
    expected = rows_alone(paths, lambda name: name.replace(str(tmp_path), "s3://plants"))
    assert rows_in("plants/out", object_store) == expected
    again = DecodeJob([pattern], "s3://plants/out", JobOptions())
    assert [*again.run(local_processes(1))] == []
    assert again.done_before == 40


def test_an_object_store_says_what_it_lacks(object_store: fs.S3FileSystem) -> None:
    with pytest.raises(InputError, match=r"s3://plants/none/\*: there is no such file"):
        list_inputs("s3://plants/none/*")
    with pytest.raises(InputError, match="s3://no-such-bucket"):
        list_inputs("s3://no-such-bucket/a.pcap")
    store = OutputStore("s3://plants/few")
    assert store.names("_mbtool") == []
    store.put("_mbtool/a.json", b"{}")
    assert (store.names("_mbtool"), store.read("_mbtool/a.json")) == (["a.json"], b"{}")
    store.delete("_mbtool/a.json")
    store.delete("_mbtool/a.json")
    assert store.names("_mbtool") == []


def test_a_scheduler_that_does_not_answer_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("mbtool.cluster.executors.CONNECT_S", 0.2)
    with pytest.raises(LinkError, match=r"tcp://127\.0\.0\.1:9: no Dask scheduler answers"):
        dask_cluster("tcp://127.0.0.1:9")
