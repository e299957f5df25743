"""The options of `sniff` for taps that speak TLS, and what is said of wrong ones."""

from __future__ import annotations

import signal
import socket
from contextlib import suppress
from typing import TYPE_CHECKING

import pytest

from mbtool.cli import exit_codes
from mbtool.cli.tls_options import TlsOptions
from mbtool.core import Endpoint, ListenTls, TapLink, TargetTls, UsageError, parse_link
from tests.certificates import CA, MASTER, SLAVE, master_context
from tests.cli.program import PATIENCE_S, CommandLine, Program, endpoint_in

if TYPE_CHECKING:
    import ssl
    from collections.abc import Callable
    from pathlib import Path

TAP = "tap:127.0.0.1:0=127.0.0.1:9"


def test_without_options_no_side_has_tls() -> None:
    none = TlsOptions()
    assert (none.listen(), none.target()) == (None, None)
    link = parse_link("rtu:/dev/ttyUSB0")
    assert none.on_taps([link]) == [link]


def test_the_files_of_a_side_go_to_every_tap() -> None:
    options = TlsOptions(
        tls_cert="cert.pem",
        tls_key="key.pem",
        tls_ca="ca.pem",
        tls_target_ca="target-ca.pem",
        tls_target_cert="target-cert.pem",
        tls_target_key="target-key.pem",
        tls_target_name="plc",
    )
    listen = ListenTls("cert.pem", "key.pem", "ca.pem")
    target = TargetTls("target-ca.pem", "target-cert.pem", "target-key.pem", "plc")
    links = [parse_link(text) for text in (TAP, "net:eth0", "tap:127.0.0.1:0=127.0.0.1:10")]
    taps = [one for one in options.on_taps(links) if isinstance(one, TapLink)]
    assert [(tap.listen_tls, tap.target_tls) for tap in taps] == [(listen, target)] * 2
    assert taps[0].target == Endpoint("127.0.0.1", 9)


def test_an_unverified_target_is_one_without_a_ca() -> None:
    assert TlsOptions(tls_target_unverified=True).target() == TargetTls(None)


@pytest.mark.parametrize(
    ("options", "problem"),
    [
        (["--tls-key", "k.pem"], "--tls-key goes with --tls-cert, the certificate that masters"),
        (["--tls-ca", "ca.pem"], "--tls-ca goes with --tls-cert, the certificate that masters"),
        (["--tls-target-cert", "c.pem"], "--tls-target-cert: say how the target is verified: --tl"),
        (["--tls-target-name", "plc"], "--tls-target-name: say how the target is verified"),
        (["--tls-target-key", "k.pem"], "--tls-target-key goes with --tls-target-cert"),
        (
            ["--tls-target-ca", "ca.pem", "--tls-target-unverified"],
            "--tls-target-ca and --tls-target-unverified exclude each other",
        ),
    ],
    ids=lambda one: " ".join(one) if isinstance(one, list) else "",
)
def test_options_that_lack_another_are_wrong_usage(
    mbtool: CommandLine, options: list[str], problem: str
) -> None:
    told = mbtool("sniff", TAP, *options)
    assert (told.code, told.out) == (exit_codes.USAGE, "")
    assert told.err.startswith(f"mbtool: {problem}")
    assert told.err.count("\n") == 1


@pytest.mark.parametrize(
    ("options", "option"),
    [
        (TlsOptions(tls_cert="a.pem"), "--tls-cert"),
        (TlsOptions(tls_target_unverified=True), "--tls-target-..."),
    ],
)
def test_where_there_is_no_tap_the_options_are_wrong_usage(
    options: TlsOptions, option: str
) -> None:
    with pytest.raises(UsageError, match=rf"^{option} is for taps, and there is none; write tap:"):
        options.on_taps([parse_link("net:eth0")])


@pytest.mark.parametrize(
    ("options", "problem"),
    [
        (["--tls-cert", "absent.pem"], "--tls-cert absent.pem: cannot be read: No such file"),
        (["--tls-cert", SLAVE, "--tls-key", MASTER], "is not that of this certificate"),
        (["--tls-target-ca", "absent.pem"], "--tls-target-ca absent.pem: cannot be read"),
    ],
)
def test_a_file_that_will_not_do_is_one_line_and_leaves_no_log(
    mbtool: CommandLine,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    options: list[str],
    problem: str,
) -> None:
    monkeypatch.chdir(tmp_path)
    told = mbtool("sniff", TAP, "-w", "a.mcap", *options)
    assert (told.code, told.out) == (exit_codes.UNREADABLE, "")
    assert told.err.startswith("mbtool: ")
    assert told.err.count("\n") == 1
    assert problem in told.err
    assert list(tmp_path.iterdir()) == []


def test_a_master_that_is_refused_is_told_and_the_run_goes_on() -> None:
    with (
        socket.create_server(("127.0.0.1", 0)) as slave,
        Program(
            "sniff",
            f"tap:127.0.0.1:0=127.0.0.1:{slave.getsockname()[1]}",
            *("--tls-cert", SLAVE, "--tls-ca", CA),
        ) as program,
    ):
        tap = endpoint_in(program.await_said("listening on"))
        _call(tap, master_context(None))
        said = program.await_said("turned away")
        slave.settimeout(PATIENCE_S)
        _call(tap, master_context(MASTER), lambda: slave.accept()[0].close())
        told = program.end(signal.SIGINT)
    assert said == "mbtool: a master was turned away: TLS: the master shows no certificate\n"
    assert told.code == exit_codes.INTERRUPTED
    assert "Traceback" not in told.err


def _call(tap: Endpoint, tls: ssl.SSLContext, connected: Callable[[], None] = lambda: None) -> None:
    """Connect, and wait until the other side ends it."""
    with (
        socket.create_connection((tap.host, tap.port), PATIENCE_S) as plain,
        suppress(OSError),
        tls.wrap_socket(plain, server_hostname="localhost") as master,
    ):
        connected()
        master.recv(1)
