"""Tells a service manager such as systemd that a service is ready, alive, or ending."""

# The protocol of sd_notify(3): a datagram of lines NAME=value to the Unix socket that the
# environment variable NOTIFY_SOCKET names; a name that begins with "@" is one of Linux's abstract
# names. The variable WATCHDOG_USEC is a period in microseconds: if the manager gets no WATCHDOG=1
# for this time, it kills the service. WATCHDOG_PID names the process that this applies to. Without
# NOTIFY_SOCKET nothing is sent. If the manager accepts no message, the recording goes on.

from __future__ import annotations

import os
import socket
from collections.abc import Mapping
from contextlib import suppress

MAX_STATUS = 500
"""The most characters of the status line that is sent to the manager."""


class ServiceManager:
    """The service manager that NOTIFY_SOCKET names; without it all methods do nothing."""

    def __init__(self, environment: Mapping[str, str]) -> None:
        self._address = environment.get("NOTIFY_SOCKET", "")
        self.watchdog_s = _watchdog_s(environment)
        """The manager kills the service if `alive` is not called for this many seconds; None if the
        manager does not watch."""

    def ready(self, status: str) -> None:
        """Tell the manager that the service is ready; `status` is one line for people."""
        self._send(f"READY=1\n{_status(status)}")

    def status(self, status: str) -> None:
        self._send(_status(status))

    def alive(self) -> None:
        self._send("WATCHDOG=1")

    def stopping(self) -> None:
        self._send("STOPPING=1")

    def _send(self, text: str) -> None:
        if not self._address or not hasattr(socket, "AF_UNIX"):
            return
        address = f"\0{self._address[1:]}" if self._address.startswith("@") else self._address
        with (
            suppress(OSError),
            socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as channel,
        ):
            channel.setblocking(False)
            channel.sendto(text.encode(), address)


def _watchdog_s(environment: Mapping[str, str]) -> float | None:
    if environment.get("WATCHDOG_PID", str(os.getpid())) != str(os.getpid()):
        return None
    text = environment.get("WATCHDOG_USEC", "")
    return int(text) / 1e6 if text.isdecimal() and len(text) < 20 and int(text) else None


def _status(text: str) -> str:
    return f"STATUS={' '.join(text.split())[:MAX_STATUS]}"
