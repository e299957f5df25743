"""Modbus/TCP Security: a tap ends TLS on either side, and records what pymodbus says inside it."""

from __future__ import annotations

from contextlib import closing
from typing import TYPE_CHECKING

import pytest

from mbtool.logs import LogReader
from tests.certificates import CA, ELSEWHERE, MASTER, SLAVE, master_context, slave_context
from tests.end_to_end.peers import SecuredClient, ask_twenty, pymodbus_server, tcp_client
from tests.end_to_end.programs import decoded, mbtool, run_mbtool, sniffing, tcp_port

if TYPE_CHECKING:
    import ssl
    from pathlib import Path

LISTEN = ("--tls-cert", SLAVE, "--tls-ca", CA)
TARGET = ("--tls-target-ca", CA, "--tls-target-cert", MASTER)
MASTER_SAID = "master TLS 1.3, CN=master, O=Test site, role Operator"
SLAVE_SAID = "slave TLS 1.3, CN=slave, O=Test site"


@pytest.mark.parametrize(
    ("options", "sides", "said"),
    [
        (LISTEN, "master", MASTER_SAID),
        (TARGET, "slave", SLAVE_SAID),
        ((*LISTEN, *TARGET), "master slave", f"{MASTER_SAID}; {SLAVE_SAID}"),
    ],
    ids=["tls-plain", "plain-tls", "tls-tls"],
)
def test_a_secured_connection_is_recorded_in_clear(
    tmp_path: Path, options: tuple[str, ...], sides: str, said: str
) -> None:
    log = tmp_path / "secured.mcap"
    server_tls: ssl.SSLContext | None = slave_context(ca=CA) if "slave" in sides else None
    with pymodbus_server(server_tls) as (port, _):
        link = f"tap:127.0.0.1:0=127.0.0.1:{port}"
        with sniffing(link, "-w", str(log), "--count", "20", *options) as sniffer:
            at = tcp_port(sniffer)
            if "master" in sides:
                with closing(SecuredClient(at, master_context())) as client:
                    assert client.connect()
                    answers = ask_twenty(client)
            else:
                with tcp_client(at) as (plain, _):
                    answers = ask_twenty(plain)
            assert sniffer.wait() == 0
    assert [answer.isError() for answer in answers] == [False] * 18 + [True] * 2
    found = decoded(log)
    assert [one["outcome"] for one in found] == ["ok"] * 18 + ["exception"] * 2
    assert [one["function"] for one in found] == [answer.function_code & 0x7F for answer in answers]
    assert found == decoded(log, "--raw")
    with LogReader.open(log) as reader:
        list(reader.items())
        (settings,) = reader.links.values()
    assert settings == {"spec": link, "tls": sides}
    assert f"connection opened: {said}" in run_mbtool("decode", str(log), "--events", "all")


@pytest.mark.parametrize("options", [TARGET, ("--tls-target-unverified", *TARGET[2:])])
def test_a_secured_slave_is_asked(options: tuple[str, ...]) -> None:
    with pymodbus_server(slave_context(ca=CA)) as (port, _):
        link = f"tcp:127.0.0.1:{port}"
        out = run_mbtool("read", link, "holding 3..5", "holding 0..150", *options)
    assert "03 read holding 3..5 -> 30, 40, 50\n" in out
    assert "03 read holding 125..150 -> 1250, 1260" in out


def test_a_secured_slave_that_refuses_is_told() -> None:
    with pymodbus_server(slave_context(ca=CA)) as (port, _):
        link = f"tcp:127.0.0.1:{port}"
        with mbtool("read", link, "holding 3", "--tls-target-ca", ELSEWHERE) as program:
            assert program.wait() == 3
            assert f"mbtool: {link}: TLS: the slave's certificate is refused" in program.said.text
    with mbtool("read", "rtu+tcp:127.0.0.1:1", "holding 3", "--tls-target-unverified") as program:
        assert program.wait() == 2
        assert "TLS is for Modbus/TCP, tcp:HOST:PORT" in program.said.text
