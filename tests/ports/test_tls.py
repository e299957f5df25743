"""What a tap's certificate files make, and what is said of those that are wrong."""

from __future__ import annotations

import ssl
from typing import TYPE_CHECKING

import pytest

from mbtool.core import LinkError, ListenTls, TargetTls
from mbtool.ports.tls import client_context, failure, server_context, why_outdated
from tests.certificates import CA, EXPIRED, EXPIRED_CA, LATIN_1, LOCKED_KEY, MASTER, SLAVE

if TYPE_CHECKING:
    from pathlib import Path

HOST = "127.0.0.1"


def test_masters_meet_tls_1_2_or_better_and_need_no_certificate() -> None:
    context = server_context(ListenTls(SLAVE))
    assert context.minimum_version is ssl.TLSVersion.TLSv1_2
    assert context.verify_mode is ssl.CERT_NONE


def test_no_master_can_renegotiate() -> None:
    assert server_context(ListenTls(SLAVE)).options & ssl.OP_NO_RENEGOTIATION


def test_with_a_ca_masters_need_a_certificate() -> None:
    assert server_context(ListenTls(SLAVE, ca=CA)).verify_mode is ssl.CERT_REQUIRED


def test_a_target_is_verified_by_its_ca_and_its_name() -> None:
    context, name = client_context(TargetTls(CA), HOST)
    assert (context.verify_mode, context.check_hostname, name) == (ssl.CERT_REQUIRED, True, HOST)
    assert context.minimum_version is ssl.TLSVersion.TLSv1_2
    assert client_context(TargetTls(CA, name="plc.example"), HOST)[1] == "plc.example"


def test_a_ca_may_have_names_that_python_cannot_read() -> None:
    assert client_context(TargetTls(LATIN_1), HOST)[0].verify_mode is ssl.CERT_REQUIRED


def test_a_target_is_taken_as_it_is_where_that_is_asked() -> None:
    context, _ = client_context(TargetTls(None), HOST)
    assert (context.verify_mode, context.check_hostname) == (ssl.CERT_NONE, False)


def test_certificate_and_key_may_be_in_two_files(tmp_path: Path) -> None:
    both = (tmp_path / "both.pem", tmp_path / "key.pem")
    with open(SLAVE, encoding="ascii") as file:
        certificate, begin, key = file.read().partition("-----BEGIN EC PRIVATE KEY")
    both[0].write_text(certificate)
    both[1].write_text(begin + key)
    server_context(ListenTls(str(both[0]), str(both[1])))
    with pytest.raises(LinkError, match="holds no private key; name its file with --tls-key"):
        server_context(ListenTls(str(both[0])))
    with pytest.raises(LinkError, match=r"--tls-cert .*key\.pem: holds no certificate in PEM"):
        server_context(ListenTls(str(both[1]), str(both[1])))
    with pytest.raises(LinkError, match="name its file with --tls-target-key"):
        client_context(TargetTls(CA, str(both[0])), HOST)


@pytest.mark.parametrize(
    ("tls", "problem"),
    [
        (ListenTls("absent.pem"), "--tls-cert absent.pem: cannot be read: No such file"),
        (ListenTls(SLAVE, "absent.pem"), "--tls-key absent.pem: cannot be read: No such file"),
        (ListenTls(SLAVE, ca="absent.pem"), "--tls-ca absent.pem: cannot be read: No such file"),
        (ListenTls(SLAVE, ca="."), "--tls-ca .: cannot be read: Is a directory"),
        (ListenTls(SLAVE, CA), "ca.pem: holds no private key in PEM"),
        (ListenTls(SLAVE, MASTER), "is not that of this certificate"),
        (
            ListenTls(MASTER, LOCKED_KEY),
            "is locked with a passphrase; unlock a copy of it: openssl",
        ),
        (ListenTls(SLAVE, ca=EXPIRED_CA), "the last ended Feb  1 00:00:00 2020 GMT"),
        (ListenTls("/dev/zero"), "--tls-cert /dev/zero: holds no certificate in PEM"),
        (TargetTls("absent.pem"), "--tls-target-ca absent.pem: cannot be read"),
        (TargetTls(CA, "absent.pem"), "--tls-target-cert absent.pem: cannot be read"),
        (TargetTls(CA, MASTER, SLAVE), "--tls-target-cert"),
        (TargetTls(CA, MASTER, "absent.pem"), "--tls-target-key absent.pem: cannot be read"),
        (TargetTls(CA, name=".plc"), "--tls-target-name '.plc': no host can have such a name"),
        (TargetTls(CA, name=""), "--tls-target-name '': no host can have such a name"),
        (TargetTls(CA, name="x" * 70), "no host can have such a name"),
    ],
    ids=str,
)
def test_what_is_wrong_with_a_file_is_one_line_that_names_it(
    tls: ListenTls | TargetTls, problem: str
) -> None:
    with pytest.raises(LinkError) as told:
        server_context(tls) if isinstance(tls, ListenTls) else client_context(tls, HOST)
    assert problem in str(told.value)
    assert "\n" not in str(told.value)


@pytest.mark.parametrize("kind", ["CERTIFICATE", "EC PRIVATE KEY"])
def test_a_damaged_file_is_one_line_too(tmp_path: Path, kind: str) -> None:
    path = tmp_path / "damaged.pem"
    with open(SLAVE, encoding="ascii") as file:
        text = file.read()
    at = text.index(f"-----BEGIN {kind}-----") + 60
    path.write_text(text[:at] + "!!!!" + text[at + 4 :])
    with pytest.raises(LinkError, match=r"damaged\.pem: cannot be used: "):
        server_context(ListenTls(str(path)))
    if kind == "CERTIFICATE":
        with pytest.raises(LinkError, match=r"--tls-target-ca .*damaged\.pem: cannot be used: "):
            client_context(TargetTls(str(path)), HOST)


def test_a_host_that_can_have_no_certificate_is_left_to_the_call() -> None:
    assert client_context(TargetTls(CA), "x" * 70)[1] == "x" * 70


def _ssl_error(reason: str) -> ssl.SSLError:
    error = ssl.SSLError(1, f"[SSL: {reason}] (_ssl.c:1006)")
    error.reason = reason
    return error


@pytest.mark.parametrize(
    ("error", "why"),
    [
        (_ssl_error("WRONG_VERSION_NUMBER"), "TLS: the slave speaks no TLS"),
        (_ssl_error("UNSUPPORTED_PROTOCOL"), "TLS: the slave has no version in common with the "
         "tap, which has 1.2 and 1.3"),
        (_ssl_error("TLSV1_ALERT_UNKNOWN_CA"), "TLS: the slave refuses: it does not know who "
         "vouches for the tap's certificate"),
        (_ssl_error("TLSV1_ALERT_INTERNAL_ERROR"), "TLS: the slave refuses: alert "
         "'internal error'"),
        (_ssl_error("NO_SHARED_CIPHER"), "TLS with the slave failed: no shared cipher"),
        (ConnectionAbortedError("SSL handshake is taking longer"), "TLS: the slave does not "
         "complete the handshake"),
        (ConnectionResetError(), "TLS: the slave breaks off the handshake"),
        (ConnectionResetError(104, "Connection reset by peer"), None),
        (ConnectionRefusedError(111, "Connection refused"), None),
    ],
)  # fmt: skip
def test_why_tls_failed_is_said_in_words(error: OSError, why: str | None) -> None:
    assert failure(error, "slave") == why


def test_a_certificate_of_the_taps_own_that_has_expired_is_told(tmp_path: Path) -> None:
    why = why_outdated("--tls-cert", EXPIRED)
    assert why == (
        f"--tls-cert {EXPIRED}: expired at 2020-02-01 00:00 UTC; peers that look will refuse it"
    )
    assert why_outdated("--tls-cert", SLAVE) is None
    other = tmp_path / "other.pem"
    assert why_outdated("--tls-cert", str(other)) is None
    other.write_text("-----BEGIN CERTIFICATE-----\n!!\n-----END CERTIFICATE-----\n")
    assert why_outdated("--tls-cert", str(other)) is None
