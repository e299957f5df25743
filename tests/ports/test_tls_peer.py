"""What a certificate says of its holder, and what of that is shown."""

from __future__ import annotations

import ssl
from datetime import UTC, datetime
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from mbtool.ports.tls_peer import MAX_TEXT, ROLE_OID, end_of, role_of, subject_of
from tests.certificates import CA, EXPIRED, MASTER, NO_ROLE, SLAVE


def der_of(path: str) -> bytes:
    text = Path(path).read_text(encoding="ascii")
    end = "-----END CERTIFICATE-----"
    return ssl.PEM_cert_to_DER_cert(text[: text.index(end) + len(end)])


def element(tag: int, content: bytes) -> bytes:
    """DER with the length in its short form, or with two bytes."""
    size = len(content)
    length = bytes([size]) if size < 0x80 else b"\x82" + size.to_bytes(2, "big")
    return bytes([tag]) + length + content


def certificate(*extensions: bytes) -> bytes:
    """As much of a certificate as counts here: X.509 with its extensions."""
    listed = element(0xA3, element(0x30, b"".join(extensions)))
    body = element(0xA0, bytes.fromhex("02 01 02")) + element(0x02, b"\x01") + listed
    return element(0x30, element(0x30, body))


def extension(value: bytes, *, oid: bytes = ROLE_OID, critical: bool = False) -> bytes:
    flag = bytes.fromhex("01 01 ff") if critical else b""
    return element(0x30, element(0x06, oid) + flag + element(0x04, value))


def test_the_role_of_a_client_is_read() -> None:
    assert role_of(der_of(MASTER)) == "Operator"


@pytest.mark.parametrize("path", [NO_ROLE, SLAVE, CA])
def test_a_certificate_without_a_role_gives_none(path: str) -> None:
    assert role_of(der_of(path)) is None


@pytest.mark.parametrize("critical", [False, True])
def test_the_role_is_found_behind_other_extensions(critical: bool) -> None:
    other = extension(b"\x04\x01\x00", oid=bytes.fromhex("551d0e"))
    role = extension(element(0x0C, "Prüfer".encode()), critical=critical)
    assert role_of(certificate(other, role)) == "Prüfer"


def test_a_role_of_another_type_is_none() -> None:
    assert role_of(certificate(extension(element(0x02, b"\x01")))) is None
    assert role_of(certificate(extension(b""))) is None


@given(st.binary(max_size=300))
def test_any_bytes_are_walked_to_an_end(data: bytes) -> None:
    role_of(data)


@given(st.data())
def test_a_damaged_certificate_is_walked_to_an_end(data: st.DataObject) -> None:
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
    assert end_of(der_of(EXPIRED)) == datetime(2020, 2, 1, tzinfo=UTC)
    assert end_of(der_of(SLAVE)) == datetime(2120, 1, 1, tzinfo=UTC)  # A time of another kind.


@given(st.binary(max_size=80))
def test_a_validity_that_cannot_be_read_has_no_end(noise: bytes) -> None:
    validity = element(0x30, element(0x17, b"200101000000Z") + element(0x17, noise))
    body = element(0x30, b"") * 2 + validity
    end = end_of(element(0x30, element(0x30, body)))
    assert end is None or len(noise) >= 8
    assert end_of(noise) is None
