"""The options of `sniff` for taps that speak TLS."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from collections.abc import Sequence

    from mbtool.core import LinkSpec, ListenTls, TargetTls

TlsCertOption = Annotated[
    str | None,
    typer.Option(
        "--tls-cert",
        metavar="FILE",
        help="Have masters connect to a tap with TLS; FILE is the certificate it shows them (PEM).",
    ),
]
TlsKeyOption = Annotated[
    str | None,
    typer.Option(
        "--tls-key",
        metavar="FILE",
        help="The private key of --tls-cert, where it is in a file of its own.",
    ),
]
TlsCaOption = Annotated[
    str | None,
    typer.Option(
        "--tls-ca",
        metavar="FILE",
        help="Let in only masters that show a certificate of a CA in FILE.",
    ),
]
TlsTargetCaOption = Annotated[
    str | None,
    typer.Option(
        "--tls-target-ca",
        metavar="FILE",
        help="Have a tap connect to its target with TLS, if that shows a certificate of a CA in "
        "FILE, or one that is in FILE itself.",
    ),
]
TlsTargetUnverifiedOption = Annotated[
    bool,
    typer.Option(
        "--tls-target-unverified",
        help="The same, whatever certificate the target shows.",
    ),
]
TlsTargetCertOption = Annotated[
    str | None,
    typer.Option(
        "--tls-target-cert",
        metavar="FILE",
        help="The certificate that a tap shows its target (PEM).",
    ),
]
TlsTargetKeyOption = Annotated[
    str | None,
    typer.Option(
        "--tls-target-key",
        metavar="FILE",
        help="The private key of --tls-target-cert, where it is in a file of its own.",
    ),
]
TlsTargetNameOption = Annotated[
    str | None,
    typer.Option(
        "--tls-target-name",
        metavar="NAME",
        help="The name or address in the target's certificate. [default: that in the LINK]",
    ),
]


def listen_tls(cert: str | None, key: str | None, ca: str | None) -> ListenTls | None:
    """What --tls-cert and its like say. Raises UsageError."""
    from mbtool.core import ListenTls, UsageError

    if cert is not None:
        return ListenTls(cert, key, ca)
    for option, given in (("--tls-key", key), ("--tls-ca", ca)):
        if given is not None:
            raise UsageError(
                f"{option} goes with --tls-cert, the certificate that masters are shown"
            )
    return None


def target_tls(
    ca: str | None, cert: str | None, key: str | None, name: str | None, *, unverified: bool
) -> TargetTls | None:
    """What --tls-target-ca and its like say. Raises UsageError."""
    from mbtool.core import TargetTls, UsageError

    if ca is not None and unverified:
        raise UsageError("--tls-target-ca and --tls-target-unverified exclude each other")
    if key is not None and cert is None:
        raise UsageError("--tls-target-key goes with --tls-target-cert")
    if ca is not None or unverified:
        return TargetTls(ca, cert, key, name)
    for option, given in (("--tls-target-cert", cert), ("--tls-target-name", name)):
        if given is not None:
            raise UsageError(
                f"{option}: say how the target is verified: --tls-target-ca FILE, "
                "or --tls-target-unverified"
            )
    return None


def with_tls(
    links: Sequence[LinkSpec], listen: ListenTls | None, target: TargetTls | None
) -> list[LinkSpec]:
    """The links, each tap with what it does for TLS. Raises UsageError where there is no tap."""
    from mbtool.core import TapLink, UsageError

    if listen is None and target is None:
        return list(links)
    if not any(isinstance(link, TapLink) for link in links):
        option = "--tls-target-..." if listen is None else "--tls-cert"
        raise UsageError(
            f"{option} is for taps, and there is none; write tap:LISTEN=TARGET, "
            "for example tap:127.0.0.1:1502=10.0.0.9:802"
        )
    return [
        replace(link, listen_tls=listen, target_tls=target) if isinstance(link, TapLink) else link
        for link in links
    ]
