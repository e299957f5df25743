"""The measuring of the slave: what it compiles, asks and says."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING

import pytest

from mbtool.core import Endpoint, TcpLink
from mbtool.devices import load_profile
from mbtool.slave.device import RegisterImage, units_on
from mbtool.slave.families import make_device
from mbtool.slave.shells import TcpSlave
from tests.benchmarks.slave import (
    FA3,
    FT1A,
    LIBMODBUS,
    PYMODBUS,
    MissingError,
    Round,
    Server,
    ask,
    compile_c,
    report,
)

if TYPE_CHECKING:
    from pathlib import Path


def _slave() -> TcpSlave:
    profile = load_profile("idec-ft1a-touch")
    device = make_device(profile, RegisterImage.of(profile))
    link = TcpLink(Endpoint("127.0.0.1", 0))
    return TcpSlave(link, units_on(link, profile, 1, device))


@pytest.mark.skipif(sys.platform == "win32", reason="the client is a POSIX program")
def test_the_client_asks_over_several_connections_and_checks_the_answers(tmp_path: Path) -> None:
    try:
        client = compile_c("slave_client", tmp_path)
    except MissingError as error:
        pytest.skip(str(error))
    with _slave() as slave:
        measured = ask(client, Server(FT1A, slave.endpoint.port, 0), 3, 0.05)
    assert measured.rate > 0
    assert measured.p99_us > 0


def test_without_a_compiler_it_says_so(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("shutil.which", lambda _: None)
    with pytest.raises(MissingError, match="there is no C compiler"):
        compile_c("slave_client", tmp_path)


def test_ratios_are_of_medians_and_only_of_what_was_measured() -> None:
    def rounds(slave: str, connections: int, cpu_us: float | None, *rates: float) -> list[Round]:
        return [Round(slave, connections, rate, 100.0, cpu_us) for rate in rates]

    text = report(
        [
            *rounds(FT1A, 1, 10.0, 30_000, 1, 99_000),
            *rounds(FA3, 1, None, 20_000),
            *rounds(PYMODBUS, 1, 50.0, 10_000),
            *rounds(FT1A, 8, 10.0, 40_000),
            *rounds(LIBMODBUS, 8, 5.0, 80_000),
        ]
    )
    assert text.splitlines() == [
        "1 connection      requests/s   p99 us   cpu us   x pymodbus  by cpu  x libmodbus  by cpu",
        "  mbtool ft1a         30,000      100     10.0         3.00    5.00            -       -",
        "  mbtool fa3          20,000      100        -         2.00       -            -       -",
        "  pymodbus            10,000      100     50.0         1.00    1.00            -       -",
        "8 connections     requests/s   p99 us   cpu us   x pymodbus  by cpu  x libmodbus  by cpu",
        "  mbtool ft1a         40,000      100     10.0            -       -         0.50    0.50",
        "  libmodbus           80,000      100      5.0            -       -         1.00    1.00",
    ]
