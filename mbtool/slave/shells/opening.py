"""Chooses the class that serves a slave on a link: a TCP or UDP endpoint, or a serial line."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import ExitStack
from typing import TYPE_CHECKING, Self

from mbtool.core import LinkSpec, SerialLink, TcpLink, UsageError
from mbtool.core.link_spec import ANSWERED
from mbtool.ports.tcp_listener import THIS_MACHINE, AllowedPeers
from mbtool.slave.shells.serial_shell import SerialSlave
from mbtool.slave.shells.tcp_shell import TcpSlave
from mbtool.slave.shells.udp_shell import UdpSlave

if TYPE_CHECKING:
    from mbtool.modbus.response import Responder
    from mbtool.slave.device.connection_policy import ConnectionPolicy
    from mbtool.slave.shells.shell import OnExchange, Shell

# ShellGroup starts and stops several shells together. A shell connects a simulated slave to one
# link.

_GLANCE_S = 0.0
"""The time (s) to wait for each shell to end: none, only its state is looked at."""


class ShellGroup:
    """Several shells on different links; a context manager that starts and stops all of them."""

    def __init__(self, shells: Sequence[Shell]) -> None:
        self._shells = shells
        self._stack = ExitStack()

    @property
    def place(self) -> str:
        """The link as text for the user; if there are several, their number."""
        count = len(self._shells)
        return self._shells[0].place if count == 1 else f"{count} links"

    @property
    def places(self) -> int:
        """The number of masters that may be connected to one of the shells at once."""
        return max(shell.places for shell in self._shells)

    @property
    def turned_away(self) -> int:
        """The number of connections refused because a shell had as many as it accepts at once."""
        return sum(shell.turned_away for shell in self._shells)

    def notes(self) -> list[str]:
        """Messages for the user on what has happened to connections since the last call."""
        return [note for shell in self._shells for note in shell.notes()]

    def wait(self, timeout_s: float | None = None) -> None:
        """Wait until the first shell has ended, or `timeout_s` seconds have passed.

        If an error ended one of the shells, it is raised: LinkError if its link was lost.
        """
        self._shells[0].wait(timeout_s)
        for shell in self._shells[1:]:
            shell.wait(_GLANCE_S)

    def __enter__(self) -> Self:
        """Start all shells; if one cannot be started, stop the others and raise its error."""
        with ExitStack() as stack:
            for shell in self._shells:
                stack.enter_context(shell)
            self._stack = stack.pop_all()
        return self

    def __exit__(self, *_: object) -> None:
        self._stack.close()


def slave_link(link: LinkSpec) -> SerialLink | TcpLink:
    """Return `link` if a slave can answer on it; otherwise raise UsageError."""
    if isinstance(link, SerialLink):
        link.demand_one_port()
    if isinstance(link, SerialLink | TcpLink):
        return link
    raise UsageError(f"link {link}: a slave needs {ANSWERED}")


def open_shell(
    link: LinkSpec,
    responder: Responder,
    *,
    allowed: AllowedPeers = THIS_MACHINE,
    rules: ConnectionPolicy | None = None,
    on_exchange: OnExchange | None = None,
    strict_timing: bool = False,
) -> Shell:
    """Return a shell, not yet started, that will answer on a link with a responder's responses.

    `allowed` are the machines that may connect, and `rules` the device's rules for connections;
    neither has any use on a serial line. With `strict_timing`, a request on an RTU line gets no
    response if the silences around it are too short, or one inside it too long. Raises UsageError
    if no slave can answer on such a link, and for strict timing on a link that is no RTU line.
    """
    where = slave_link(link)
    if isinstance(where, SerialLink):
        return SerialSlave(where, responder, on_exchange=on_exchange, strict_timing=strict_timing)
    if strict_timing:
        raise UsageError(f"link {link}: strict timing is for RTU lines")
    if where.is_udp:
        return UdpSlave(where, responder, allowed=allowed, on_exchange=on_exchange)
    return TcpSlave(where, responder, allowed=allowed, rules=rules, on_exchange=on_exchange)
