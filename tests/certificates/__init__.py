"""Certificates for tests, with their keys, which protect nothing."""

# Made once with openssl, so that no test needs a tool, and valid from 2020 to 2120, but for
# EXPIRED_CA and EXPIRED. CA signed SLAVE (localhost, 127.0.0.1), ELSEWHERE (plc.example), MASTER
# (role Operator), NO_ROLE and EXPIRED; OTHER_CA signed STRANGER. LATIN_1 and NO_SUBJECT signed
# themselves (127.0.0.1): one, a CA, has another name, which is not in ASCII, the other is called
# nothing else. A leaf's file holds its certificate, then its private key.

from __future__ import annotations

import ssl
from pathlib import Path

_FOLDER = Path(__file__).parent

CA = str(_FOLDER / "ca.pem")
OTHER_CA = str(_FOLDER / "other-ca.pem")
EXPIRED_CA = str(_FOLDER / "expired-ca.pem")
SLAVE = str(_FOLDER / "slave.pem")
ELSEWHERE = str(_FOLDER / "elsewhere.pem")
MASTER = str(_FOLDER / "master.pem")
NO_ROLE = str(_FOLDER / "no-role.pem")
EXPIRED = str(_FOLDER / "expired.pem")
STRANGER = str(_FOLDER / "stranger.pem")
LATIN_1 = str(_FOLDER / "latin-1.pem")
NO_SUBJECT = str(_FOLDER / "no-subject.pem")
LOCKED_KEY = str(_FOLDER / "locked-key.pem")
"""MASTER's key, locked with the passphrase "secret"."""

TLS_1_2, TLS_1_3 = ssl.TLSVersion.TLSv1_2, ssl.TLSVersion.TLSv1_3


def slave_context(
    cert: str = SLAVE, *, ca: str | None = None, version: ssl.TLSVersion = TLS_1_3
) -> ssl.SSLContext:
    """What a slave needs to be called with TLS; with a CA it demands certificates."""
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.maximum_version = version
    context.load_cert_chain(cert)
    if ca is not None:
        context.load_verify_locations(ca)
        context.verify_mode = ssl.CERT_REQUIRED
    return context


def master_context(
    cert: str | None = MASTER, *, ca: str = CA, version: ssl.TLSVersion = TLS_1_3
) -> ssl.SSLContext:
    """What a master needs to call with TLS."""
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    context.maximum_version = version
    context.load_verify_locations(ca)
    if cert is not None:
        context.load_cert_chain(cert)
    return context
