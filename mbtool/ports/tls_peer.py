"""Describes the peer of a TLS connection from its certificate."""

# Python's ssl gives the subject of a verified certificate, but few of its extensions. In Modbus/TCP
# Security a client's role is in an extension: 1.3.6.1.4.1.50316.802.1, a UTF8String
# (MB-TCP-Security-v21, 8.4). The library cryptography reads this extension, and the time at which a
# certificate expires. It is installed with the extra mbtool[tls]; without it TLS works, but roles
# and expired certificates are not reported.
#
# The text in a peer's certificate cannot be trusted: at most MAX_TEXT characters of it are shown,
# and control characters are shown as escapes, so that they do not control the terminal.

from __future__ import annotations

import ssl
from contextlib import suppress
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Mapping
    from datetime import datetime

ROLE = "1.3.6.1.4.1.50316.802.1"
MAX_TEXT = 200

_ROLE_DER = bytes.fromhex("06 0b 2b06010401 83890c 8622 01")
"""The id of the role extension, encoded in DER. Only a certificate with these bytes can have a
role."""
_SHORT = {
    "commonName": "CN",
    "organizationName": "O",
    "organizationalUnitName": "OU",
    "countryName": "C",
    "stateOrProvinceName": "ST",
    "localityName": "L",
}
"""The short names of attributes of a certificate's subject (RFC 4514, 3)."""


class PeerTls(ssl.SSLObject):
    """A TLS connection that accepts a peer's certificate with names that are not UTF-8.

    Old CAs wrote such names. Without this class, ssl verifies such a certificate and then raises
    UnicodeDecodeError when asyncio asks for the names, so the handshake fails.
    """

    def getpeercert(self, binary_form: bool = False) -> Any:
        try:
            return super().getpeercert(binary_form)
        except UnicodeDecodeError:
            return {}


def described(tls: ssl.SSLObject) -> str:
    """Return a text about the peer, such as "TLS 1.3, CN=master, O=Test site, role Operator"."""
    version = (tls.version() or "TLS").replace("TLSv", "TLS ")
    der = tls.getpeercert(binary_form=True)
    if der is None:
        return f"{version}, no certificate"
    is_verified = tls.context.verify_mode is not ssl.CERT_NONE
    nameless = "certificate without a readable name" if is_verified else "certificate not verified"
    said = [version, subject_of(tls.getpeercert() or {}) or nameless]
    if _ROLE_DER in der:
        try:
            role = role_of(der)
        except ImportError:
            said.append("a role, which the extra mbtool[tls] would show")
        else:
            said += [] if role is None else [f"role {_printable(role)}"]
    return ", ".join(said)


def subject_of(certificate: Mapping[str, Any]) -> str:
    """Return the subject of a certificate as text, its attributes in reverse order: CN first.

    `certificate` is the result of ssl's getpeercert. If it has no subject, the text is made of the
    alternative names (subjectAltName).
    """
    names = [pair for part in certificate.get("subject", ()) for pair in part]
    said = [f"{_SHORT.get(key, key)}={value}" for key, value in names[::-1]]
    said = said or [f"{kind} {name}" for kind, name in certificate.get("subjectAltName", ())]
    return _printable(", ".join(said))


def load_reader() -> None:
    """Import the library cryptography, if it is installed. Call this before an event loop runs.

    The import takes 0.1 s, in which an event loop could do nothing else.
    """
    with suppress(ImportError):
        import cryptography.x509  # noqa: F401


def role_of(der: bytes) -> str | None:
    """Return the role in a certificate (DER); None if it has no role that can be read.

    Raises ImportError without the extra mbtool[tls].
    """
    from cryptography import x509
    from cryptography.hazmat.asn1 import decode_der

    try:
        extensions = x509.load_der_x509_certificate(der).extensions
        extension = extensions.get_extension_for_oid(x509.ObjectIdentifier(ROLE))
        role: str = decode_der(str, extension.value.public_bytes())
    except (
        ValueError,
        x509.DuplicateExtension,
        x509.ExtensionNotFound,
        x509.InvalidVersion,
        x509.UnsupportedGeneralNameType,
    ):
        return None
    return role


def end_of(pem: bytes) -> datetime | None:
    """Return the time at which the first certificate in a PEM file expires; None if it cannot be
    read.

    Raises ImportError without the extra mbtool[tls].
    """
    from cryptography import x509

    try:
        end: datetime = x509.load_pem_x509_certificate(pem).not_valid_after_utc
    except (ValueError, x509.InvalidVersion):
        return None
    return end


def _printable(text: str) -> str:
    shown = "".join(
        one if one.isprintable() else one.encode("unicode_escape").decode()
        for one in text[:MAX_TEXT]
    )
    return f"{shown}..." if len(text) > MAX_TEXT else shown
