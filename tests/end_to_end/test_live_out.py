"""What sniff tells a Mosquitto broker, a Prometheus server and commands, while it records."""

from __future__ import annotations

import json
import shutil
import signal
import socket
import subprocess
import urllib.request
from contextlib import contextmanager
from threading import Event, Thread
from typing import TYPE_CHECKING
from urllib.parse import quote

import pytest

import mbtool
from tests.api.masters import ask
from tests.cli.program import PATIENCE_S, Program, endpoint_in, patient

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from mbtool.core import Endpoint

pytest.importorskip("paho", reason="paho-mqtt is not installed: pip install 'mbtool[mqtt]'")

MODULE = "fa3-at1m8x"
TIMER = "Split reception monitoring timer"
WRITES = 2000


def needs(program: str, package: str) -> str:
    path = shutil.which(program) or shutil.which(f"/usr/sbin/{program}")
    if path is None:
        pytest.skip(f"needs {program}: apt-get install {package}")
    return path


def free_port() -> int:
    with socket.create_server(("127.0.0.1", 0)) as server:
        port: int = server.getsockname()[1]
        return port


@contextmanager
def broker(folder: Path, *lines: str, port: int | None = None) -> Iterator[int]:
    """A Mosquitto broker, on a given port or a free one; yields its port."""
    port = port or free_port()
    settings = folder / "mosquitto.conf"
    settings.write_text("\n".join([f"listener {port} 127.0.0.1", *lines]))
    command = [needs("mosquitto", "mosquitto"), "-c", str(settings)]
    with subprocess.Popen(command, stderr=subprocess.DEVNULL) as running:
        wait = patient()
        while True:
            try:
                socket.create_connection(("127.0.0.1", port)).close()
                break
            except OSError:
                wait()
        try:
            yield port
        finally:
            running.terminate()


def write_timer(tap: Endpoint, count: int) -> None:
    """Write the timer of the module `count` times, each time with another value."""
    with socket.create_connection((tap.host, tap.port), PATIENCE_S) as master:
        for number in range(count):
            pdu = bytes.fromhex("06 00f5") + (1 + number % 100).to_bytes(2)
            assert ask(master, 0, pdu) == pdu


@contextmanager
def sniffing(*arguments: object) -> Iterator[tuple[Program, Endpoint]]:
    """A module behind a tap, and a sniffer that listens there; yields it and where the tap is."""
    with mbtool.Slave(MODULE, unit=0) as slave:
        tap = f"tap:127.0.0.1:0={slave.host}:{slave.port}"
        with Program("sniff", tap, "--device", f"all={MODULE}", *arguments) as program:
            yield program, endpoint_in(program.await_said("listening on"))


def subscribed(port: int, topic: str, count: int) -> dict[str, bytes]:
    """The messages that a client of Mosquitto gets for a topic: the first `count` of them."""
    command = [
        needs("mosquitto_sub", "mosquitto-clients"), "-h", "127.0.0.1", "-p", str(port),
        "-t", topic, "-C", str(count), "-W", str(int(PATIENCE_S)), "-F", "%t\t%p",
    ]  # fmt: skip
    told = subprocess.run(command, capture_output=True, check=True).stdout
    lines = (line.partition(b"\t") for line in told.splitlines())
    return {topic.decode(): payload for topic, _, payload in lines}


def test_named_values_come_to_a_broker_where_home_assistant_finds_them(tmp_path: Path) -> None:
    with (
        broker(tmp_path, "allow_anonymous true") as port,
        sniffing("--mqtt", f"mqtt://127.0.0.1:{port}/site7") as (program, tap),
    ):
        write_timer(tap, 3)
        (config,) = subscribed(port, "homeassistant/#", 1).values()
        found = json.loads(config)
        assert (found["name"], found["unit_of_measurement"]) == (TIMER, "s")
        assert found["device"]["model"] == MODULE
        state = found["state_topic"]
        assert state.startswith("site7/127.0.0.1:")
        wait = patient()
        while json.loads(subscribed(port, state, 1)[state])["value"] != 3:
            wait()
        assert subscribed(port, "site7/status", 1) == {"site7/status": b"online"}
        program.end(signal.SIGINT)
        assert subscribed(port, "site7/status", 1) == {"site7/status": b"offline"}


@contextmanager
def nobody() -> Iterator[int]:
    yield free_port()


@contextmanager
def silent() -> Iterator[int]:
    """A broker that takes connections, and neither reads nor answers."""
    with socket.create_server(("127.0.0.1", 0)) as server:
        yield server.getsockname()[1]


@contextmanager
def hanging_up() -> Iterator[int]:
    """A broker that ends each connection at once."""
    with socket.create_server(("127.0.0.1", 0)) as server:
        ended = Event()

        def serve() -> None:
            while not ended.is_set():
                try:
                    server.accept()[0].close()
                except OSError:
                    return

        Thread(target=serve, daemon=True).start()
        try:
            yield server.getsockname()[1]
        finally:
            ended.set()
            socket.create_connection(server.getsockname()).close()


@pytest.mark.parametrize("state", [nobody, silent, hanging_up])
def test_a_recording_loses_nothing_whatever_the_broker_does(state: object, tmp_path: Path) -> None:
    log = tmp_path / "x.mcap"
    assert callable(state)
    with (
        state() as port,
        sniffing("-w", log, "--mqtt", f"mqtt://127.0.0.1:{port}", "--metrics", ":0") as (
            program,
            tap,
        ),
    ):
        write_timer(tap, WRITES)
        program.end(signal.SIGINT)
    capture = mbtool.open(log)
    assert sum(one.took_effect for one in capture) == WRITES
    assert {one.kind for one in capture.events()} <= {
        mbtool.EventKind.OPENED, mbtool.EventKind.CLOSED,
    }  # fmt: skip


def test_a_broker_that_refuses_is_told_once_and_the_recording_goes_on(tmp_path: Path) -> None:
    log = tmp_path / "x.mcap"
    with broker(tmp_path, "allow_anonymous false") as port, mbtool.Slave(MODULE, unit=0) as slave:
        tap = f"tap:127.0.0.1:0={slave.host}:{slave.port}"
        told = ("-w", log, "--mqtt", f"mqtt://127.0.0.1:{port}")
        with Program("sniff", tap, "--device", f"all={MODULE}", *told) as program:
            assert program.process.stderr is not None
            lines: list[str] = []
            while not all(any(word in line for line in lines) for word in ("mqtt", "listening")):
                lines.append(program.process.stderr.readline())
                assert lines[-1], lines
            (place,) = (line for line in lines if "listening" in line)
            write_timer(endpoint_in(place), 100)
            lines += program.end(signal.SIGINT).err.splitlines()
    (refused,) = (line for line in lines if "mqtt" in line)
    assert "refuses the connection: Not authorized; recording goes on" in refused
    assert sum(one.took_effect for one in mbtool.open(log)) == 100


def test_prometheus_fetches_counts_latencies_and_troubles(tmp_path: Path) -> None:
    prometheus, port = needs("prometheus", "prometheus"), free_port()
    with sniffing("--metrics", ":0") as (program, tap):
        place = endpoint_in(program.await_said("metrics at"))
        settings = tmp_path / "prometheus.yml"
        settings.write_text(
            "scrape_configs:\n- job_name: mbtool\n  scrape_interval: 1s\n"
            f"  static_configs:\n  - targets: ['{place}']\n"
        )
        write_timer(tap, 20)
        with socket.create_connection((tap.host, tap.port), PATIENCE_S) as master:
            ask(master, 0, bytes.fromhex("03 f000 0001"))
        command = [
            prometheus, f"--config.file={settings}", f"--storage.tsdb.path={tmp_path / 'data'}",
            f"--web.listen-address=127.0.0.1:{port}",
        ]  # fmt: skip
        with subprocess.Popen(command, stderr=subprocess.DEVNULL) as server:
            try:
                ok = 'mbtool_transactions_total{function="06",outcome="ok"}'
                assert asked(port, ok, "20") == "20"
                assert float(asked(port, 'mbtool_latency_seconds_count{function="06"}', "20")) == 20
                assert asked(port, 'mbtool_trouble{code="UNIT-REFUSES"}', "1") == "1"
            finally:
                server.terminate()


def asked(port: int, query: str, wanted: str) -> str:
    """Ask Prometheus until it gives the wanted value; return it."""
    wait = patient()
    while True:
        address = f"http://127.0.0.1:{port}/api/v1/query?query={quote(query)}"
        try:
            with urllib.request.urlopen(address) as answer:
                found = json.loads(answer.read())["data"]["result"]
        except OSError:
            found = []
        if found and found[0]["value"][1] == wanted:
            return wanted
        wait()


def test_a_command_runs_once_for_a_trouble(tmp_path: Path) -> None:
    told = tmp_path / "told.txt"
    line = f'echo "$MBTOOL_CODE $MBTOOL_UNIT" >> {told}'
    with sniffing("--on", f"UNIT-REFUSES={line}") as (program, tap):
        with socket.create_connection((tap.host, tap.port), PATIENCE_S) as master:
            wait = patient()
            while not told.exists() or not told.read_text():
                ask(master, 0, bytes.fromhex("03 f000 0001"))
                wait()
            for _ in range(10):
                ask(master, 0, bytes.fromhex("03 f000 0001"))
        program.end(signal.SIGINT)
    assert told.read_text() == "UNIT-REFUSES 0\n"


def test_a_broker_that_was_restarted_without_its_memory_gets_all_values_again(
    tmp_path: Path,
) -> None:
    port = free_port()
    with sniffing("--mqtt", f"mqtt://127.0.0.1:{port}/site7") as (program, tap):
        for _ in range(2):
            with broker(tmp_path, "allow_anonymous true", port=port):
                write_timer(tap, 1)  # The same value each time, so it has not changed.
                # The value, its description for Home Assistant, the status.
                assert len(subscribed(port, "#", 3)) == 3
        program.end(signal.SIGINT)


def test_the_files_around_a_trouble_are_kept(tmp_path: Path) -> None:
    log = tmp_path / "x.mcap"
    options = ("--rotate", "20KB", "--keep", 2, "--keep-around", "UNIT-REFUSES")
    with sniffing("-w", log, *options) as (program, tap):
        write_timer(tap, 100)
        with socket.create_connection((tap.host, tap.port), PATIENCE_S) as master:
            wait = patient()
            while not list(tmp_path.glob("x-*-kept.mcap")):
                for _ in range(10):
                    ask(master, 0, bytes.fromhex("03 f000 0001"))
                wait()
        write_timer(tap, 100)
        program.end(signal.SIGINT)
    kept = sorted(tmp_path.glob("x-*-kept.mcap"))
    assert any(one.exception for path in kept for one in mbtool.open(path))
    assert len(list(tmp_path.glob("x-????.mcap"))) <= 2
