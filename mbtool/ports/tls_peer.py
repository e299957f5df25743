"""Who is at the other end of a TLS connection, as its certificate says."""

# Python's ssl gives the subject of a certificate that it has verified, and of its extensions almost
# none. The one that counts for Modbus/TCP Security is the role of a client: extension
# 1.3.6.1.4.1.50316.802.1, a UTF8String (MB-TCP-Security-v21, 8.4). So the certificate is walked to
# its extensions: DER (X.690, 8.1 and 10), each element a tag, a length and its content. The walk
# goes from an element to the next, never into what it does not look for, so it is no longer than
# the certificate, which TLS bounds; anything odd in it ends it without a role. The certificate was
# read by OpenSSL before.
#
# What a certificate says was written by others: at most MAX_TEXT characters of it are shown, and
# of those that a terminal would act on, their escapes.

from __future__ import annotations

import ssl
from datetime import datetime
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

ROLE_OID = bytes.fromhex("2b 06 01 04 01 83890c 8622 01")
"""1.3.6.1.4.1.50316.802.1"""
MAX_TEXT = 200

_SEQUENCE, _OCTETS, _OID, _UTF8, _EXTENSIONS = 0x30, 0x04, 0x06, 0x0C, 0xA3
_UTC_TIME = 0x17
_SHORT = {
    "commonName": "CN",
    "organizationName": "O",
    "organizationalUnitName": "OU",
    "countryName": "C",
    "stateOrProvinceName": "ST",
    "localityName": "L",
}
"""RFC 4514, 3."""

Element = tuple[int, bytes]


class PeerTls(ssl.SSLObject):
    """TLS with a peer whose certificate may have names that are not UTF-8, as old CAs wrote them.

    ssl, and with it the handshake of asyncio, fails at these after it has verified them.
    """

    def getpeercert(self, binary_form: bool = False) -> Any:
        try:
            return super().getpeercert(binary_form)
        except UnicodeDecodeError:
            return {}


def described(tls: ssl.SSLObject) -> str:
    """TLS 1.3, CN=master, O=Test site, role Operator."""
    version = (tls.version() or "TLS").replace("TLSv", "TLS ")
    der = tls.getpeercert(binary_form=True)
    if der is None:
        return f"{version}, no certificate"
    is_verified = tls.context.verify_mode is not ssl.CERT_NONE
    nameless = "certificate without a readable name" if is_verified else "certificate not verified"
    said = [version, subject_of(tls.getpeercert() or {}) or nameless]
    role = role_of(der)
    if role is not None:
        said.append(f"role {_printable(role)}")
    return ", ".join(said)


def subject_of(certificate: Mapping[str, Any]) -> str:
    """The subject of a certificate as ssl gives it, the most particular name first.

    Where it has none, what else the certificate calls its holder.
    """
    names = [pair for part in certificate.get("subject", ()) for pair in part]
    said = [f"{_SHORT.get(key, key)}={value}" for key, value in names[::-1]]
    said = said or [f"{kind} {name}" for kind, name in certificate.get("subjectAltName", ())]
    return _printable(", ".join(said))


def role_of(der: bytes) -> str | None:
    """The role that a certificate gives its holder, None where it gives none."""
    for extension in _extensions(der):
        parts = list(_elements(extension))
        if parts and parts[0] == (_OID, ROLE_OID) and parts[-1][0] == _OCTETS:
            tag, text = next(_elements(parts[-1][1]), (0, b""))
            return text.decode(errors="replace") if tag == _UTF8 else None
    return None


def end_of(der: bytes) -> datetime | None:
    """When a certificate's validity ends; None where that cannot be read."""
    for wanted in (_SEQUENCE, _SEQUENCE):
        der = next((content for tag, content in _elements(der) if tag == wanted), b"")
    # RFC 5280, 4.1: of what are sequences the third, behind the signature's kind and the issuer.
    sequences = [content for tag, content in _elements(der) if tag == _SEQUENCE]
    times = list(_elements(sequences[2])) if len(sequences) > 2 else []
    if len(times) != 2:
        return None
    tag, text = times[1][0], times[1][1].decode("ascii", "replace")
    if tag == _UTC_TIME:  # Two digits for the year, 50 and later of the century before (4.1.2.5.1).
        text = ("19" if text >= "50" else "20") + text
    try:
        return datetime.strptime(text, "%Y%m%d%H%M%S%z")
    except ValueError:
        return None


def _extensions(der: bytes) -> Iterator[bytes]:
    """The content of each extension: identifier, whether critical, value. RFC 5280, 4.1."""
    for wanted in (_SEQUENCE, _SEQUENCE, _EXTENSIONS, _SEQUENCE):
        der = next((content for tag, content in _elements(der) if tag == wanted), b"")
    for tag, content in _elements(der):
        if tag == _SEQUENCE:
            yield content


def _elements(der: bytes) -> Iterator[Element]:
    """The elements that stand one behind the other, up to one that is not whole."""
    at = 0
    while at + 2 <= len(der):
        tag, size = der[at], der[at + 1]
        at += 2
        if size >= 0x80:
            wide = size & 0x7F
            if not 0 < wide <= 4 or at + wide > len(der):
                return
            size = int.from_bytes(der[at : at + wide], "big")
            at += wide
        if at + size > len(der):
            return
        yield tag, der[at : at + size]
        at += size


def _printable(text: str) -> str:
    shown = "".join(
        one if one.isprintable() else one.encode("unicode_escape").decode()
        for one in text[:MAX_TEXT]
    )
    return f"{shown}..." if len(text) > MAX_TEXT else shown
