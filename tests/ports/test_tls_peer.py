"""What a certificate says of its holder, and what of that is shown."""

from __future__ import annotations

import ssl
import sys
from datetime import UTC, datetime
from pathlib import Path

import pytest
from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec
from hypothesis import given
from hypothesis import strategies as st

from mbtool.core import ListenTls
from mbtool.ports.tls import (
    MAX_TEXT,
    ROLE,
    described,
    end_of,
    role_of,
    server_context,
    subject_of,
    why_outdated,
)
from tests.certificates import CA, EXPIRED, LATIN_1, MASTER, NO_ROLE, SLAVE

KEY = ec.generate_private_key(ec.SECP256R1())


def der_of(path: str) -> bytes:
    text = Path(path).read_text(encoding="ascii")
    end = "-----END CERTIFICATE-----"
    return ssl.PEM_cert_to_DER_cert(text[: text.index(end) + len(end)])


def certificate(role: bytes, *, critical: bool = False) -> bytes:
    """A certificate with the role as its last extension."""
    name = x509.Name([x509.NameAttribute(x509.NameOID.COMMON_NAME, "a")])
    at = datetime(2026, 1, 1, tzinfo=UTC)
    builder = x509.CertificateBuilder(name, name, KEY.public_key(), 1, at, at)
    builder = builder.add_extension(x509.BasicConstraints(ca=False, path_length=None), True)
    extension = x509.UnrecognizedExtension(x509.ObjectIdentifier(ROLE), role)
    builder = builder.add_extension(extension, critical)
    signed = builder.sign(KEY, hashes.SHA256())
    der: bytes = signed.public_bytes(serialization.Encoding.DER)
    return der


def test_the_role_of_a_client_is_read() -> None:
    assert role_of(der_of(MASTER)) == "Operator"


@pytest.mark.parametrize("path", [NO_ROLE, SLAVE, CA, LATIN_1])
def test_a_certificate_without_a_role_gives_none(path: str) -> None:
    assert role_of(der_of(path)) is None


@pytest.mark.parametrize("critical", [False, True])
def test_the_role_is_found_behind_other_extensions(critical: bool) -> None:
    role = b"\x0c\x07" + "Prüfer".encode()  # UTF8String
    assert role_of(certificate(role, critical=critical)) == "Prüfer"


@pytest.mark.parametrize("value", ["020101", "0c01ff", "0c05", "", "0c016100"])
def test_a_role_that_is_no_text_is_none(value: str) -> None:
    assert role_of(certificate(bytes.fromhex(value))) is None


class _Peer:
    """As much of an SSLObject as counts here."""

    context = ssl.create_default_context()

    def __init__(self, der: bytes) -> None:
        self._der = der

    def version(self) -> str:
        return "TLSv1.3"

    def getpeercert(self, binary_form: bool = False) -> object:
        return self._der if binary_form else {"subject": ((("commonName", "master"),),)}


@pytest.mark.parametrize(
    ("path", "with_the_extra", "without"),
    [
        (
            MASTER,
            "TLS 1.3, CN=master, role Operator",
            "TLS 1.3, CN=master, a role, which the extra mbtool[tls] would show",
        ),
        (NO_ROLE, "TLS 1.3, CN=master", "TLS 1.3, CN=master"),
    ],
)
def test_without_the_extra_only_the_role_is_missing(
    monkeypatch: pytest.MonkeyPatch, path: str, with_the_extra: str, without: str
) -> None:
    peer = _Peer(der_of(path))
    assert described(peer) == with_the_extra  # type: ignore[arg-type]
    for name in ("cryptography", "cryptography.x509", "cryptography.hazmat.asn1"):
        monkeypatch.setitem(sys.modules, name, None)
    assert described(peer) == without  # type: ignore[arg-type]
    assert why_outdated("--tls-cert", EXPIRED) is None
    assert server_context(ListenTls(SLAVE, ca=CA)).verify_mode is ssl.CERT_REQUIRED


@given(st.binary(max_size=300))
def test_any_bytes_are_read_without_an_error(data: bytes) -> None:
    role_of(data)


@given(st.data())
def test_a_damaged_certificate_is_read_without_an_error(data: st.DataObject) -> None:
    der = bytearray(der_of(MASTER))
    at = data.draw(st.integers(0, len(der) - 1))
    der[at] = data.draw(st.integers(0, 255))
    cut = data.draw(st.integers(0, len(der)))
    role_of(bytes(der[:cut]))


def test_a_subject_is_shown_with_the_most_particular_name_first() -> None:
    subject = (
        (("countryName", "JP"),),
        (("organizationName", "Site"),),
        (("commonName", "plc-1"), ("serialNumber", "7")),
    )
    assert subject_of({"subject": subject}) == "serialNumber=7, CN=plc-1, O=Site, C=JP"
    assert subject_of({}) == ""


def test_a_holder_without_a_subject_is_shown_by_its_other_names() -> None:
    others = (("DNS", "plc.example"), ("IP Address", "10.0.0.9"))
    assert subject_of({"subjectAltName": others}) == "DNS plc.example, IP Address 10.0.0.9"
    assert subject_of({"subject": (), "subjectAltName": others[1:]}) == "IP Address 10.0.0.9"


def test_what_a_terminal_would_act_on_is_escaped_and_long_names_are_cut() -> None:
    assert subject_of({"subject": ((("commonName", "a\x1b[2J\n"),),)}) == r"CN=a\x1b[2J\n"
    long = subject_of({"subject": ((("commonName", "x" * 1000),),)})
    assert long == "CN=" + "x" * (MAX_TEXT - 3) + "..."


def test_the_end_of_a_certificates_validity_is_read() -> None:
    assert end_of(Path(EXPIRED).read_bytes()) == datetime(2020, 2, 1, tzinfo=UTC)
    assert end_of(Path(SLAVE).read_bytes()) == datetime(2120, 1, 1, tzinfo=UTC)
    assert end_of(Path(LATIN_1).read_bytes()) is not None


@given(st.binary(max_size=80))
def test_a_certificate_that_cannot_be_read_has_no_end(noise: bytes) -> None:
    assert end_of(noise) is None
    assert end_of(ssl.DER_cert_to_PEM_cert(noise).encode()) is None
