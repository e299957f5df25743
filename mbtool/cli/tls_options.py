"""The options for TLS: of taps (`mbtool sniff`), and of masters (`read`, `write` and `poll`)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Annotated, ClassVar

import typer

from mbtool.cli.option_groups import OptionGroup
from mbtool.core import LinkSpec, ListenTls, TapLink, TargetTls, UsageError


@dataclass(frozen=True, slots=True)
class TargetTlsOptions(OptionGroup):
    """The TLS options for the connection to a slave."""

    heading: ClassVar[str] = "TLS"

    tls_target_ca: Annotated[
        str | None,
        typer.Option(
            "--tls-target-ca",
            metavar="FILE",
            help="Connect to the slave with TLS, if it shows a certificate of a CA in FILE, or one "
            "that is in FILE itself.",
        ),
    ] = None
    tls_target_unverified: Annotated[
        bool,
        typer.Option(
            "--tls-target-unverified", help="The same, whatever certificate the target shows."
        ),
    ] = False
    tls_target_cert: Annotated[
        str | None,
        typer.Option(
            "--tls-target-cert",
            metavar="FILE",
            help="The certificate that the slave is shown (PEM).",
        ),
    ] = None
    tls_target_key: Annotated[
        str | None,
        typer.Option(
            "--tls-target-key",
            metavar="FILE",
            help="The private key of --tls-target-cert, where it is in a file of its own.",
        ),
    ] = None
    tls_target_name: Annotated[
        str | None,
        typer.Option(
            "--tls-target-name",
            metavar="NAME",
            help="The name or address in the slave's certificate. [default: that in the LINK]",
        ),
    ] = None

    def target(self) -> TargetTls | None:
        """Return the TLS settings of the connection to the slave; None if no option asks for TLS.

        Raises UsageError if options contradict each other or lack one that they need.
        """
        ca, cert, key = self.tls_target_ca, self.tls_target_cert, self.tls_target_key
        if ca is not None and self.tls_target_unverified:
            raise UsageError("--tls-target-ca and --tls-target-unverified exclude each other")
        if key is not None and cert is None:
            raise UsageError("--tls-target-key goes with --tls-target-cert")
        if ca is not None or self.tls_target_unverified:
            return TargetTls(ca, cert, key, self.tls_target_name)
        for option, given in (
            ("--tls-target-cert", cert),
            ("--tls-target-name", self.tls_target_name),
        ):
            if given is not None:
                raise UsageError(
                    f"{option}: say how the target is verified: --tls-target-ca FILE, "
                    "or --tls-target-unverified"
                )
        return None


@dataclass(frozen=True, slots=True)
class TlsOptions(TargetTlsOptions):
    """The TLS options of a tap: for the masters that connect to it, and for its target."""

    tls_cert: Annotated[
        str | None,
        typer.Option(
            "--tls-cert",
            metavar="FILE",
            help="Have masters connect to a tap with TLS; FILE is the certificate it shows them "
            "(PEM).",
        ),
    ] = None
    tls_key: Annotated[
        str | None,
        typer.Option(
            "--tls-key",
            metavar="FILE",
            help="The private key of --tls-cert, where it is in a file of its own.",
        ),
    ] = None
    tls_ca: Annotated[
        str | None,
        typer.Option(
            "--tls-ca",
            metavar="FILE",
            help="Let in only masters that show a certificate of a CA in FILE.",
        ),
    ] = None

    def on_taps(self, links: Sequence[LinkSpec]) -> list[LinkSpec]:
        """Return the links, with the TLS of both sides added to each tap.

        Raises UsageError for TLS options without a tap, and for options that contradict each other.
        """
        listen, target = self.listen(), self.target()
        if listen is None and target is None:
            return list(links)
        if not any(isinstance(link, TapLink) for link in links):
            option = "--tls-target-..." if listen is None else "--tls-cert"
            raise UsageError(
                f"{option} is for taps, and there is none; write tap:LISTEN=TARGET, "
                "for example tap:127.0.0.1:1502=10.0.0.9:802"
            )
        return [
            replace(link, listen_tls=listen, target_tls=target)
            if isinstance(link, TapLink)
            else link
            for link in links
        ]

    def listen(self) -> ListenTls | None:
        """Return the TLS settings for masters that connect to a tap; None without --tls-cert.

        Raises UsageError for an option that needs --tls-cert, if this is missing.
        """
        if self.tls_cert is not None:
            return ListenTls(self.tls_cert, self.tls_key, self.tls_ca)
        for option, given in (("--tls-key", self.tls_key), ("--tls-ca", self.tls_ca)):
            if given is not None:
                raise UsageError(
                    f"{option} goes with --tls-cert, the certificate that masters are shown"
                )
        return None

    def warnings(self) -> list[str]:
        """Return a warning for each of the tap's own certificates that has expired."""
        from mbtool.ports.tls import why_outdated

        own = {"--tls-cert": self.tls_cert, "--tls-target-cert": self.tls_target_cert}
        found = [why_outdated(option, cert) for option, cert in own.items() if cert is not None]
        return [warning for warning in found if warning is not None]
