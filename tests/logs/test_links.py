"""Settings of links and devices, read from a log."""

from __future__ import annotations

from io import BytesIO
from typing import TYPE_CHECKING

import pytest

from mbtool.core import SerialLink, UsageError
from mbtool.logs import LogReader, LogWriter
from mbtool.logs.links import (
    ANY_PORT,
    PORTS,
    RTU_PORTS,
    SPEC,
    names_any_port,
    ports_of,
    serial_lines,
)

if TYPE_CHECKING:
    from pathlib import Path


def _log(path: Path, **links: dict[str, str]) -> LogReader:
    with LogWriter(path, capture={}) as log:
        for name, settings in links.items():
            log.add_link(name, settings)
    return LogReader(BytesIO(path.read_bytes()), str(path))


def test_ports_and_lines_of_all_links_are_given(tmp_path: Path) -> None:
    log = _log(
        tmp_path / "a.mcap",
        eth0={SPEC: "net:eth0", PORTS: f"1502 502 {ANY_PORT} x 1234567", RTU_PORTS: "4001"},
        eth1={SPEC: "net:eth1", PORTS: "503", RTU_PORTS: ""},
        ttyUSB0={SPEC: "rtu:/dev/ttyUSB0@9600-8N1"},
        other={},
    )
    assert ports_of(log, PORTS) == (502, 503, 1502)
    assert ports_of(log, RTU_PORTS) == (4001,)
    assert names_any_port(log)
    lines = serial_lines(log)
    assert isinstance(lines["ttyUSB0"], SerialLink)
    assert [*lines] == ["ttyUSB0"]


def test_a_log_may_have_no_link_specs_or_invalid_ones(tmp_path: Path) -> None:
    log = _log(tmp_path / "a.mcap", eth0={SPEC: "net:eth0", PORTS: "502"})
    assert not names_any_port(log)
    assert serial_lines(log) == {}
    with pytest.raises(UsageError):
        serial_lines(_log(tmp_path / "b.mcap", x={SPEC: "what:ever"}))
