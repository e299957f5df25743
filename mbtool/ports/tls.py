"""TLS for a tap: makes TLS contexts from certificate files, and explains failed handshakes."""

# Modbus/TCP Security (MB-TCP-Security-v21, chapter 6) is Modbus/TCP inside TLS 1.2 or later, with a
# certificate at each end. A tap cannot decrypt a connection that passes through it. So it ends the
# master's TLS connection, with a certificate of its own, and opens another one to the slave. The
# user chooses for each of the two connections whether it has TLS.
#
# All files are read before a connection is accepted; a LinkError names the file that is wrong. Each
# certificate in a CA file is trusted, even if it belongs to no CA, such as the certificate of the
# slave itself. If the file holds no CA certificate, the slave must show one of the certificates in
# the file, and the name in it is not checked.

from __future__ import annotations

import re
import ssl
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mbtool.core import LinkError, ListenTls, TargetTls
from mbtool.ports.clock import now_ns

if TYPE_CHECKING:
    from datetime import datetime


_CERTIFICATE = re.compile(rb"-----BEGIN (?:X509 |TRUSTED )?CERTIFICATE-----")
_KEY = re.compile(rb"-----BEGIN (?:[A-Z0-9]+ )*PRIVATE KEY-----")
_ALERT = re.compile(r"(?:SSLV3|TLSV1|TLSV13)_ALERT_(\w+)")

_NO_TLS = frozenset(
    {
        "BAD_RECORD_TYPE",
        "HTTPS_PROXY_REQUEST",
        "HTTP_REQUEST",
        "PACKET_LENGTH_TOO_LONG",
        "RECORD_LAYER_FAILURE",
        "UNKNOWN_PROTOCOL",
        "WRONG_VERSION_NUMBER",
    }
)
"""OpenSSL's reasons, in several versions, for a failed handshake in which the peer's first bytes
are not TLS."""
_TOO_OLD = frozenset(
    {
        "NO_PROTOCOLS_AVAILABLE",
        "TLSV1_ALERT_PROTOCOL_VERSION",
        "UNSUPPORTED_PROTOCOL",
        "VERSION_TOO_LOW",
    }
)
_OTHER_NAMES = frozenset({62, 64})
"""OpenSSL's error codes for a certificate with another name than the expected one:
X509_V_ERR_HOSTNAME_MISMATCH and X509_V_ERR_IP_ADDRESS_MISMATCH."""
_REFUSALS = {
    "BAD_CERTIFICATE": "the tap's certificate is not to its liking",
    "CERTIFICATE_EXPIRED": "the tap's certificate has expired",
    "CERTIFICATE_REQUIRED": "it demands a certificate of the tap",
    "CERTIFICATE_UNKNOWN": "the tap's certificate is not to its liking",
    "HANDSHAKE_FAILURE": "it demands a certificate, or has no cipher in common",
    "UNKNOWN_CA": "it does not know who vouches for the tap's certificate",
}
"""The reasons why a peer refuses the tap, as texts for the user, by the name of the TLS alert that
the peer sends (RFC 8446, 6.2)."""


def server_context(tls: ListenTls) -> ssl.SSLContext:
    """Return the TLS context for connections from masters to a tap.

    Raises LinkError if a certificate or key file cannot be used.
    """
    context = _context(ssl.PROTOCOL_TLS_SERVER)
    _load_own(context, "--tls-cert", tls.cert, tls.key)
    if tls.ca is not None:
        _load_ca(context, "--tls-ca", tls.ca)
        context.verify_mode = ssl.CERT_REQUIRED
    return context


def why_outdated(option: str, cert: str) -> str | None:
    """Return a line for the user if the tap's own certificate has expired, otherwise None.

    `cert` is the path of the certificate file, and `option` the option that named it. An expired
    certificate is still used, as not every peer checks the date. The result is also None if the
    extra mbtool[tls] is not installed, or if the file cannot be read.
    """
    try:
        end = end_of(Path(cert).read_bytes())
    except (OSError, ImportError):
        return None
    if end is None or end.timestamp() >= now_ns() / 1e9:
        return None
    return f"{option} {cert}: expired at {end:%Y-%m-%d %H:%M} UTC; peers that look will refuse it"


def client_context(tls: TargetTls, host: str) -> tuple[ssl.SSLContext, str]:
    """Return the TLS context for connections from a tap to its target, and the target's name.

    The target's certificate must have this name: --tls-target-name, or without it `host`. Raises
    LinkError if a certificate or key file, or --tls-target-name, cannot be used.
    """
    context = _context(ssl.PROTOCOL_TLS_CLIENT)
    if tls.ca is None:
        context.check_hostname = False
        context.verify_mode = ssl.CERT_NONE
    else:
        _load_ca(context, "--tls-target-ca", tls.ca)
        # x509_ca counts the certificates that could sign others. If it is 0, the file holds the
        # target's own certificate, and its name is not checked.
        if tls.name is None and not context.cert_store_stats()["x509_ca"]:
            context.check_hostname = False
    if tls.cert is not None:
        _load_own(context, "--tls-target-cert", tls.cert, tls.key)
    name = host if tls.name is None else tls.name
    try:
        context.wrap_bio(ssl.MemoryBIO(), ssl.MemoryBIO(), server_hostname=name)
    except (ValueError, ssl.SSLError):
        if tls.name is not None:
            raise LinkError(
                f"--tls-target-name {name!r}: no host can have such a name; "
                "give the one in the target's certificate"
            ) from None
        # Without --tls-target-name, `name` is the host in the user's LINK, and no valid host name.
        # It is returned nevertheless: the connection to it fails with an error that says so.
    return context, name


def failure(error: OSError, who: str) -> str | None:
    """Return a text that says why TLS with `who` failed; None if the error does not come from TLS.

    `who` is "master" or "slave".
    """
    if isinstance(error, ssl.SSLCertVerificationError):
        why = error.verify_message.rstrip(".")
        if error.verify_code in _OTHER_NAMES:
            why += "; --tls-target-name says which name it has instead"
        return f"TLS: the {who}'s certificate is refused: {why}"
    if not isinstance(error, ssl.SSLError):
        # asyncio reports a failed handshake by one of the next two errors, without an errno. If the
        # operating system raises such an error, it has an errno.
        if isinstance(error, ConnectionAbortedError) and error.errno is None:
            return f"TLS: the {who} does not complete the handshake"
        if isinstance(error, ConnectionResetError) and error.errno is None:
            return f"TLS: the {who} breaks off the handshake"
        return None
    reason = error.reason or str(error)
    alert = _ALERT.fullmatch(reason)
    if reason in _NO_TLS:
        return f"TLS: the {who} speaks no TLS"
    if reason in _TOO_OLD:
        return f"TLS: the {who} has no version in common with the tap, which has 1.2 and 1.3"
    if reason == "PEER_DID_NOT_RETURN_A_CERTIFICATE":
        return f"TLS: the {who} shows no certificate"
    if alert is not None:
        words = _REFUSALS.get(alert[1]) or f"alert {alert[1].replace('_', ' ').lower()!r}"
        return f"TLS: the {who} refuses: {words}"
    return f"TLS with the {who} failed: {_error_text(error)}"


def _context(protocol: int) -> ssl.SSLContext:
    load_reader()
    context = ssl.SSLContext(protocol)
    context.minimum_version = ssl.TLSVersion.TLSv1_2
    context.options |= ssl.OP_NO_RENEGOTIATION  # A peer could make the tap calculate for ever.
    context.sslobject_class = PeerTls
    return context


def _load_own(context: ssl.SSLContext, option: str, cert: str, key: str | None) -> None:
    held = _pem(option, cert, _CERTIFICATE, "certificate")
    if key is None:
        if _KEY.search(held) is None:
            raise LinkError(
                f"{option} {cert}: holds no private key; name its file with {_key_of(option)}"
            )
        key = cert
    else:
        _pem(_key_of(option), key, _KEY, "private key")

    def refuse() -> bytes:
        raise LinkError(
            f"{_key_of(option)} {key}: the private key is locked with a passphrase; "
            f"unlock a copy of it: openssl pkey -in {key} -out unlocked.pem"
        )

    try:
        context.load_cert_chain(cert, key, refuse)
    except ssl.SSLError as error:
        if error.reason == "KEY_VALUES_MISMATCH":
            problem = f"the private key in {key} is not that of this certificate"
        else:
            problem = f"cannot be used: {_error_text(error)}"
        raise LinkError(f"{option} {cert}: {problem}") from None


def _load_ca(context: ssl.SSLContext, option: str, path: str) -> None:
    _pem(option, path, _CERTIFICATE, "certificate")
    try:
        context.load_verify_locations(path)
    except ssl.SSLError as error:
        raise LinkError(f"{option} {path}: cannot be used: {_error_text(error)}") from None
    ends: list[str] = []
    with suppress(UnicodeDecodeError):  # A name is not UTF-8: only the handshake can tell.
        ends = [str(one["notAfter"]) for one in context.get_ca_certs()]
    last = max(ends, key=ssl.cert_time_to_seconds, default=None)
    if last is not None and ssl.cert_time_to_seconds(last) < now_ns() / 1e9:
        raise LinkError(f"{option} {path}: holds no CA that is still valid; the last ended {last}")
    context.verify_flags |= ssl.VERIFY_X509_PARTIAL_CHAIN


MAX_PEM = 1 << 20
"""The first bytes of a certificate or key file in which its first PEM block is looked for."""


def _pem(option: str, path: str, label: re.Pattern[bytes], what: str) -> bytes:
    """Return the content of a certificate or key file, which the user gave by `option`.

    The file must have a line that `label` matches: the first line of a PEM block of the wanted
    kind. `what` names this kind for the error. Raises LinkError if the file cannot be read or has
    no such line.
    """
    try:
        with open(path, "rb") as file:
            held = file.read(MAX_PEM)
    except OSError as error:
        raise LinkError(f"{option} {path}: cannot be read: {error.strerror}") from None
    if label.search(held) is None:
        raise LinkError(
            f"{option} {path}: holds no {what} in PEM (-----BEGIN ...); "
            "openssl converts other formats"
        )
    return held


def _key_of(option: str) -> str:
    return option.removesuffix("cert") + "key"


def _error_text(error: ssl.SSLError) -> str:
    return (error.reason or str(error)).replace("_", " ").lower()


# The code below describes the peer of a TLS connection from its certificate.
#
# Python's ssl gives the subject of a verified certificate, but few of its extensions. In Modbus/TCP
# Security a client's role is in an extension: 1.3.6.1.4.1.50316.802.1, a UTF8String
# (MB-TCP-Security-v21, 8.4). The library cryptography reads this extension, and the time at which a
# certificate expires. It is installed with the extra mbtool[tls]; without it TLS works, but roles
# and expired certificates are not reported.
#
# The text in a peer's certificate cannot be trusted: at most MAX_TEXT characters of it are shown,
# and control characters are shown as escapes, so that they do not control the terminal.

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
