"""The options by which `sniff` tells other programs what it hears."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, ClassVar

import typer

from mbtool.cli.option_groups import OptionGroup

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from mbtool.ports.tcp_listener import AllowedPeers
    from mbtool.workflows.live_out import LiveOut


@dataclass(frozen=True, slots=True)
class LiveOutOptions(OptionGroup):
    """The options --mqtt, --metrics and --on."""

    heading: ClassVar[str] = "Live out"

    mqtt: Annotated[
        str | None,
        typer.Option(
            "--mqtt",
            metavar="URL",
            help="Publish named values when they change: mqtt://HOST[:PORT][/PREFIX], mqtts:// "
            "with TLS. Home Assistant finds them by itself.",
        ),
    ] = None
    metrics: Annotated[
        str | None,
        typer.Option(
            "--metrics",
            metavar="HOST:PORT",
            help="Serve counts, latencies and troubles for Prometheus; :9502 is 127.0.0.1:9502.",
        ),
    ] = None
    on_trouble: Annotated[
        list[str] | None,
        typer.Option(
            "--on",
            metavar="CODE=CMD",
            help="Run a command of the shell when a trouble whose code begins so is first told: "
            "'UNIT-MISSING=...'. Repeatable.",
        ),
    ] = None

    def open(
        self,
        on_remark: Callable[[str], None],
        allowed: AllowedPeers,
        kept_codes: Sequence[str] = (),
    ) -> LiveOut:
        """Return what the options ask for, not yet entered.

        `allowed` may fetch the metrics; `kept_codes` are the codes of --keep-around.

        Raises UsageError for an option that is wrong, or a package that is missing.
        """
        from mbtool.core import UsageError
        from mbtool.ports.metrics_server import MetricsServer, parse_place
        from mbtool.ports.mqtt import Broker, MqttPublisher
        from mbtool.workflows.live_out import LiveOut

        commands = []
        for text in self.on_trouble or ():
            code, equals, line = text.partition("=")
            if not equals or not code or not line.strip():
                raise UsageError(f"--on {text}: write CODE=COMMAND, such as 'LINE-=logger ...'")
            commands.append((code, line))
        publisher = None
        if self.mqtt is not None:
            publisher = MqttPublisher(Broker.parse(self.mqtt), on_remark)
        server = None if self.metrics is None else MetricsServer(parse_place(self.metrics), allowed)
        return LiveOut(publisher, server, commands, on_remark, kept_codes)
