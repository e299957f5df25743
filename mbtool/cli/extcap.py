"""mbtool extcap: show a serial line as an interface of Wireshark."""

from __future__ import annotations

import os
import sys
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated

import typer

from mbtool.cli import exit_codes
from mbtool.cli.listening import sniffer_of
from mbtool.cli.option_groups import OptionGroup, with_option_groups
from mbtool.cli.options import TcpPorts, assignments
from mbtool.cli.talk import Interrupted, interruptible, say
from mbtool.core import LinkSpec, OutputError, SerialLink, UsageError, parse_link
from mbtool.core.errors import reason_of
from mbtool.core.link_spec import HEARD
from mbtool.version import __version__

if TYPE_CHECKING:
    from mbtool.devices import Assignments

_ASKED_BY = "Asked by Wireshark"
NONE = "none"


@dataclass(frozen=True, slots=True)
class WiresharkOptions(OptionGroup):
    """The options with which Wireshark calls an extcap program; extcap(4) describes them."""

    extcap_interfaces: Annotated[
        bool, typer.Option("--extcap-interfaces", help=f"{_ASKED_BY}: which interfaces there are.")
    ] = False
    extcap_interface: Annotated[
        str | None,
        typer.Option("--extcap-interface", metavar="NAME", help=f"{_ASKED_BY}: this interface."),
    ] = None
    extcap_dlts: Annotated[
        bool, typer.Option("--extcap-dlts", help=f"{_ASKED_BY}: its link types.")
    ] = False
    extcap_config: Annotated[
        bool, typer.Option("--extcap-config", help=f"{_ASKED_BY}: its dialog.")
    ] = False
    capture: Annotated[bool, typer.Option("--capture", help=f"{_ASKED_BY}: begin to capture.")] = (
        False
    )
    fifo: Annotated[
        str | None,
        typer.Option("--fifo", metavar="PIPE", help=f"{_ASKED_BY}: where packets are written."),
    ] = None


@dataclass(frozen=True, slots=True)
class LineOptions(OptionGroup):
    """The settings of the serial line that the user chose in Wireshark's dialog."""

    port: Annotated[
        str | None, typer.Option("--port", metavar="PORT", help="The port that hears the line.")
    ] = None
    path: Annotated[
        str | None,
        typer.Option("--path", metavar="PORT", help="A port that the dialog does not list."),
    ] = None
    baud: Annotated[
        str, typer.Option("--baud", metavar="RATE|auto", help="The baud rate; auto finds all.")
    ] = "auto"
    format_: Annotated[
        str, typer.Option("--format", metavar="8E1", help="Data bits, parity, stop bits.")
    ] = "8E1"
    mode: Annotated[str, typer.Option("--mode", metavar="rtu|ascii", help="RTU or ASCII.")] = "rtu"
    device: Annotated[
        str | None, typer.Option("--device", metavar="PROFILE", help="The profile of all slaves.")
    ] = None
    devices: Annotated[
        str | None,
        typer.Option("--devices", metavar="UNIT=PROFILE,...", help="Profiles by unit."),
    ] = None

    def link(self) -> LinkSpec:
        """Return the serial line.

        Raises UsageError if no port is named or the settings are wrong.
        """
        port = next((one for one in (self.path, self.port) if one and one != NONE), None)
        if port is None:
            raise UsageError("no serial port is chosen; choose one in the dialog of the interface")
        if self.mode not in ("rtu", "ascii"):
            raise UsageError(f"--mode {self.mode!r}: write rtu or ascii")
        settings = self.baud if self.baud == "auto" else f"{self.baud}-{self.format_}"
        return parse_link(f"{self.mode}:{port}@{settings}", HEARD)

    def assignments(self) -> Assignments:
        """Return the profiles of the slaves. Raises an error if a text names no profile."""
        texts = [one.strip() for one in (self.devices or "").split(",") if one.strip()]
        if self.device not in (None, "", NONE):
            texts.append(f"all={self.device}")
        return assignments(texts)


@with_option_groups
def extcap(
    *,
    install: Annotated[
        bool, typer.Option("--install", help="Make Wireshark show the interface.")
    ] = False,
    uninstall: Annotated[bool, typer.Option("--uninstall", help="Undo --install.")] = False,
    asked: WiresharkOptions,
    line: LineOptions,
) -> None:
    """Show a serial line live in Wireshark, as one of its interfaces.

    --install makes Wireshark and tshark list "Modbus serial line"; its dialog has port, baud rate,
    format, mode and device. Frames are shown as by mbtool convert: docs/wireshark.md. All other
    options are those that Wireshark gives.
    """
    if install or uninstall:
        _install(is_wanted=install)
    elif asked.extcap_interfaces:
        from mbtool.views.extcap_dialog import interfaces_text

        sys.stdout.write(interfaces_text(__version__))
    elif asked.extcap_dlts:
        from mbtool.views.extcap_dialog import link_types_text

        sys.stdout.write(link_types_text())
    elif asked.extcap_config:
        _print_dialog()
    elif asked.capture:
        if asked.fifo is None:
            raise UsageError("--capture goes with --fifo PIPE; Wireshark gives both")
        _capture(asked.fifo, line)
    else:
        raise UsageError("give --install or --uninstall; Wireshark itself gives all other options")


def _install(*, is_wanted: bool) -> None:
    from mbtool.workflows.extcap_install import install, scripts, uninstall

    paths = scripts(os.environ)
    if is_wanted:
        install(paths)
        for path in paths:
            say(f"written: {path}")
        say('Wireshark lists "Modbus serial line" when it is started again')
        return
    removed = uninstall(paths)
    for path in removed:
        say(f"removed: {path}")
    if not removed:
        say("nothing to remove")


def _print_dialog() -> None:
    from mbtool.devices import builtin_profiles, load_profile
    from mbtool.ports.local_ports import local_ports
    from mbtool.views.extcap_dialog import dialog_text

    profiles = [load_profile(name) for name in builtin_profiles()]
    sys.stdout.write(dialog_text(local_ports(), profiles))


def _capture(fifo: str, options: LineOptions) -> None:
    """Listen to the line and write packets to the pipe `fifo` until Wireshark stops.

    Raises LinkError if the port cannot be opened.
    """
    from mbtool.decode.line_timing import LineTiming
    from mbtool.ports.tcp_listener import THIS_MACHINE
    from mbtool.workflows.extcap import LivePackets
    from mbtool.workflows.sniff import with_settings

    link, devices = options.link(), options.assignments()
    try:
        pipe = open(fifo, "wb")  # noqa: SIM115 - closed below
    except OSError as error:
        raise OutputError(f"{fifo}: cannot be written: {reason_of(error)}") from error
    timing = LineTiming(devices)
    with pipe:
        # Finding the settings of the line may take minutes, and Wireshark ends it with SIGTERM. So
        # this is outside of interruptible(), which would delay the end.
        try:
            (line,) = timing.given(with_settings([link], say))
        except KeyboardInterrupt:
            raise Interrupted from None  # Wireshark would show a message as an error.
        if not isinstance(line, SerialLink):
            raise UsageError(f"link {line}: is no serial line")
        sniffer = sniffer_of([line], timing, TcpPorts([], [], False), THIS_MACHINE)
        try:
            with interruptible() as interrupt, sniffer:
                live = LivePackets(pipe, line, devices)
                for record in sniffer.records(lambda _: interrupt.asked):
                    live.write(record)
        except BrokenPipeError:
            raise typer.Exit(exit_codes.DONE) from None  # Wireshark has stopped.
