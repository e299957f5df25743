"""The options of `sniff` for taps that speak TLS, and what is said of wrong ones."""

from __future__ import annotations

import signal
import socket
from contextlib import suppress
from typing import TYPE_CHECKING

import pytest

from mbtool.cli import exit_codes
from mbtool.cli.tls_options import listen_tls, target_tls, with_tls
from mbtool.core import Endpoint, ListenTls, TapLink, TargetTls, UsageError, parse_link
from tests.certificates import CA, MASTER, SLAVE, master_context
from tests.cli.program import PATIENCE_S, CommandLine, Program, endpoint_in

if TYPE_CHECKING:
    import ssl
    from collections.abc import Callable
    from pathlib import Path

TAP = "tap:127.0.0.1:0=127.0.0.1:9"


def test_without_options_no_side_has_tls() -> None:
    assert listen_tls(None, None, None) is None
    assert target_tls(None, None, None, None, unverified=False) is None
    link = parse_link("rtu:/dev/ttyUSB0")
    assert with_tls([link], None, None) == [link]


def test_the_files_of_a_side_go_to_every_tap() -> None:
    listen = listen_tls("cert.pem", "key.pem", "ca.pem")
    target = target_tls("ca.pem", "cert.pem", "key.pem", "plc", unverified=False)
    assert listen == ListenTls("cert.pem", "key.pem", "ca.pem")
    assert target == TargetTls("ca.pem", "cert.pem", "key.pem", "plc")
    links = [parse_link(text) for text in (TAP, "net:eth0", "tap:127.0.0.1:0=127.0.0.1:10")]
    taps = [one for one in with_tls(links, listen, target) if isinstance(one, TapLink)]
    assert [(tap.listen_tls, tap.target_tls) for tap in taps] == [(listen, target)] * 2
    assert taps[0].target == Endpoint("127.0.0.1", 9)


def test_an_unverified_target_is_one_without_a_ca() -> None:
    assert target_tls(None, None, None, None, unverified=True) == TargetTls(None)


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
    ("listen", "target", "option"),
    [(ListenTls("a.pem"), None, "--tls-cert"), (None, TargetTls(None), "--tls-target-...")],
)
def test_where_there_is_no_tap_the_options_are_wrong_usage(
    listen: ListenTls | None, target: TargetTls | None, option: str
) -> None:
    with pytest.raises(UsageError, match=rf"^{option} is for taps, and there is none; write tap:"):
        with_tls([parse_link("net:eth0")], listen, target)


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
