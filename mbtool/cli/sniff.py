"""mbtool sniff: listen on links, decode and log what is heard."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from functools import partial
from math import inf
from typing import TYPE_CHECKING, Annotated, ClassVar, Literal

import typer

from mbtool.cli import exit_codes
from mbtool.cli.connection_options import ConnectionOptions
from mbtool.cli.listening import (
    allowed_networks,
    chosen_tcp_ports,
    found_settings,
    read_only_taps,
    sniffer_of,
)
from mbtool.cli.log_options import LogOptions
from mbtool.cli.option_groups import OptionGroup, with_option_groups
from mbtool.cli.options import (
    AllowOption,
    DeviceOption,
    EventsOption,
    Format,
    PortOptions,
    ReadOnlyOption,
    SilenceOptions,
    TableOptionGroup,
    WaitOption,
    WhereOption,
    assignments,
    condition,
)
from mbtool.cli.talk import Interrupted, interruptible, never_suspended, never_waiting, say
from mbtool.cli.tls_options import TlsOptions
from mbtool.core import LinkSpec, SerialLink, UsageError, parse_link
from mbtool.core.link_spec import HEARD
from mbtool.core.serial_format import ModemLine, ModemLines

if TYPE_CHECKING:
    from mbtool.cli.output import RecordOutput
    from mbtool.cli.service import ServiceRun
    from mbtool.cli.talk import Interrupt
    from mbtool.devices import Assignments
    from mbtool.ports.tcp_listener import AllowedPeers
    from mbtool.workflows.live_out import LiveOut
    from mbtool.workflows.sniff import Sniffer
    from mbtool.workflows.stats import LiveStatistics

# The options by which `sniff` tells other programs what it hears.


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


# The options for the modem lines DTR and RTS of serial ports.


LineChoice = Literal["keep", "off"]
"""The values of --dtr and --rts."""


@dataclass(frozen=True, slots=True)
class ModemOptions(OptionGroup):
    """The options --dtr and --rts: the state of each when a serial port is opened to listen."""

    dtr: Annotated[
        LineChoice | None,
        typer.Option(
            "--dtr",
            help="The kernel raises DTR when a serial port is opened, and drops it at the end. "
            "off: drop it right after the opening; keep: do not drop it at the end.",
        ),
    ] = None
    rts: Annotated[LineChoice | None, typer.Option("--rts", help="The same for RTS.")] = None

    def applied_to(self, links: Sequence[LinkSpec]) -> list[LinkSpec]:
        """Return the links, with the chosen states of DTR and RTS in the serial lines.

        Raises UsageError if states are chosen but no link is a serial line.
        """
        chosen = ModemLines(*(ModemLine(one or ModemLine.RAISED) for one in (self.dtr, self.rts)))
        if chosen != ModemLines() and not any(isinstance(link, SerialLink) for link in links):
            raise UsageError("--dtr and --rts are for serial lines; none of the links is one")
        return [
            replace(link, modem_lines=chosen) if isinstance(link, SerialLink) else link
            for link in links
        ]


@with_option_groups
def sniff(
    links: Annotated[
        list[str],
        typer.Argument(
            metavar="LINK",
            help="rtu:PORT@19200-8E1, ascii:PORT@9600-7E1, net:INTERFACE or tap:LISTEN=TARGET. "
            "Several are heard at once. rtu:PORT,PORT@... is one line with two taps: the master's "
            "side, the slaves' side. rtutap:PORT@...=PORT relays between the ends of a cut line.",
        ),
    ],
    *,
    log: LogOptions,
    device: DeviceOption = None,
    where: WhereOption = None,
    duration: Annotated[
        float | None,
        typer.Option("--duration", metavar="S", min=0, help="Stop after so many seconds."),
    ] = None,
    count: Annotated[
        int | None,
        typer.Option("--count", metavar="N", min=1, help="Stop after so many transactions."),
    ] = None,
    reconnect: Annotated[
        bool,
        typer.Option(
            "--reconnect/--no-reconnect",
            help="Open a serial port or an interface that is lost again when it is back.",
        ),
    ] = True,
    wait: WaitOption = None,
    ports: PortOptions,
    silences: SilenceOptions,
    modem: ModemOptions,
    format_: Annotated[Format, typer.Option("--format", help="How to print.")] = Format.TABLE,
    table: TableOptionGroup,
    events: EventsOption = None,
    allow: AllowOption = None,
    connections: ConnectionOptions,
    read_only: ReadOnlyOption = False,
    live_out: LiveOutOptions,
    tls: TlsOptions,
) -> None:
    """Listen on links, show each transaction as it ends, and log it.

    Sniffing never writes to the line; only a tap passes on what it hears. --where chooses what is
    shown; the log gets everything.
    """
    from mbtool.cli.live_output import LiveOutput
    from mbtool.cli.output import open_output, say_troubles
    from mbtool.cli.service import ServiceRun
    from mbtool.decode.line_timing import LineTiming
    from mbtool.workflows.sniff import serial_lines
    from mbtool.workflows.stats import LiveStatistics

    log.check()
    specs = tls.on_taps([parse_link(link, HEARD) for link in links])
    for warning in tls.warnings():
        say(f"mbtool: {warning}")
    allowed = allowed_networks(specs, allow, connections, serves=live_out.metrics is not None)
    codes = log.keep_around or ()
    told = live_out.open(lambda text: say(f"mbtool: {text}"), allowed, codes)
    devices, wanted = assignments(device), condition(where)
    tcp_ports = chosen_tcp_ports(specs, ports)
    specs = read_only_taps(specs, tcp_ports) if read_only else specs
    timing = LineTiming(devices, *silences.read())
    # Finding the settings of a line may take minutes, so errors are checked before that.
    serial_lines(specs)
    log.check_path()
    specs = modem.applied_to(timing.given(found_settings(specs, wait)))
    run = ServiceRun(os.environ) if log.service else None
    begin = log.creation(specs, timing, tcp_ports, told, run)
    sniffer = sniffer_of(specs, timing, tcp_ports, allowed, begin, reconnects=reconnect)
    with (
        interruptible() as interrupt,
        never_suspended() as tell_suspension,
        never_waiting(),
        ExitStack() as opened,
    ):
        is_hurried = partial(getattr, interrupt, "asked")
        live = partial(
            LiveOutput, is_kept=begin is not None, is_hurried=is_hurried, is_silent=log.service
        )
        opened.enter_context(told)
        opened.enter_context(sniffer)
        # The sniffer is opened before the output, and closed before it. So the log is complete when
        # the command waits for the reader of its output.
        with (
            open_output(
                None,
                format_,
                events,
                devices.profile_for,
                wanted,
                count,
                is_kept=begin is not None,
                table=table.read(),
                make_output=live,
            ) as out,
            opened.pop_all(),
        ):
            say(f"listening on {', '.join(sniffer.places)}; Ctrl-C ends")
            if told.metrics_place is not None:
                say(f"metrics at http://{told.metrics_place}/metrics")
            if run is not None:
                run.begin(sniffer)
            heard = serial_lines(specs)
            formats = {name: timing.format_of(line) for name, line in heard.items()}
            judged = LiveStatistics(formats.get, None, devices)
            look = partial(told.look, live=judged)
            ends = _end(interrupt, out, duration, tell_suspension, run, look)
            _show(sniffer, out, judged, told, devices, heard, ends, is_hurried)
            judged.close()
            if run is not None:
                run.end()
        if not log.service:
            say_troubles(judged.judgement())
        if begin is not None:
            say(f"log: {log.place()}")
    if isinstance(out, LiveOutput) and out.has_failed:
        raise typer.Exit(exit_codes.UNREADABLE)
    if interrupt.asked:
        raise Interrupted


def _end(
    interrupt: Interrupt,
    out: RecordOutput,
    duration_s: float | None,
    tell_suspension: Callable[[], None],
    run: ServiceRun | None,
    look: Callable[[int], None],
) -> Callable[[int], bool]:
    """Return a function that takes the time in ns since 1970 and returns True if sniff must end.

    It must end after Ctrl-C, after --limit rows or after `duration_s` seconds (None: no limit). At
    each call the function also flushes the output, calls `tell_suspension`, and lets `run` send
    its messages to the service manager; `look` tells other programs what is due.
    """
    from mbtool.ports.clock import now_ns

    end_ns = inf if duration_s is None else now_ns() + duration_s * 1e9

    def ends(at_ns: int) -> bool:
        out.wait()
        tell_suspension()
        if run is not None:
            run.look()
        look(at_ns)
        return interrupt.asked or out.is_full or at_ns >= end_ns

    return ends


def _show(
    sniffer: Sniffer,
    out: RecordOutput,
    live: LiveStatistics,
    told: LiveOut,
    devices: Assignments,
    lines: Mapping[str, SerialLink],
    ends: Callable[[int], bool],
    is_hurried: Callable[[], bool],
) -> None:
    """Print records as they come, and remarks on device models and on lines that cannot be read.

    `live` counts and judges them, `told` passes them on to other programs.
    `devices` are the profiles of --device, and `lines` the serial lines by the name of their link.
    """
    from mbtool.workflows.shared.model_hints import ModelHints
    from mbtool.workflows.shared.unreadable_lines import UnreadableLines

    hints = ModelHints(devices.profile_for)
    unreadable = UnreadableLines(lines.get, is_live=True)
    for record in sniffer.records(ends, is_hurried):
        for remark in (hints.note(record), unreadable.note(record)):
            if remark is not None:
                say(f"mbtool: {remark}")
        live.add(record)
        told.take(record)
        if not out.is_full:
            out.add(record)
