"""Two network namespaces with a cable between them, made by `ip` and taken down again."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterator

IPV4 = ("10.90.0.1", "10.90.0.2")
IPV6 = ("fd90::1", "fd90::2")
INTERFACE = "cable"
"""What each end of the cable is called in its namespace."""


@dataclass(frozen=True, slots=True)
class Cable:
    """The namespaces of its two ends."""

    master: str
    slave: str

    def within(self, namespace: str, *command: str) -> tuple[str, ...]:
        """The command that runs another in a namespace."""
        return (_ip(), "netns", "exec", namespace, *command)


def why_not() -> str | None:
    """What keeps this process from making namespaces; None where nothing does."""
    if sys.platform != "linux":
        return "network namespaces need Linux"
    if shutil.which("ip", path=_PATH) is None:
        return "needs ip: apt install iproute2"
    name = f"mbtool-try-{os.getpid()}"
    tried = subprocess.run([_ip(), "netns", "add", name], capture_output=True, text=True)
    if tried.returncode:
        return f"network namespaces are not permitted: {tried.stderr.strip()}"
    _run("netns", "delete", name)
    return None


@contextmanager
def cable(name: str = "mbtool") -> Iterator[Cable]:
    """Both ends are up and have the addresses of IPV4 and IPV6.

    Cables of one process that are there at once need different names.
    """
    ends = Cable(f"{name}-m-{os.getpid()}", f"{name}-s-{os.getpid()}")
    names = (ends.master, ends.slave)
    try:
        for name in names:
            _run("netns", "add", name)
        peer = ("peer", "name", INTERFACE, "netns", ends.slave)
        _run("-n", ends.master, "link", "add", INTERFACE, "type", "veth", *peer)
        for name, v4, v6 in zip(names, IPV4, IPV6, strict=True):
            _run("-n", name, "address", "add", f"{v4}/24", "dev", INTERFACE)
            # Without duplicate detection the address can be used at once.
            _run("-n", name, "address", "add", f"{v6}/64", "dev", INTERFACE, "nodad")
            for interface in ("lo", INTERFACE):
                _run("-n", name, "link", "set", interface, "up")
        yield ends
    finally:
        for name in names:
            subprocess.run([_ip(), "netns", "delete", name], capture_output=True, check=False)


_PATH = os.pathsep.join((os.environ.get("PATH", ""), "/usr/sbin", "/sbin"))


def _ip() -> str:
    return shutil.which("ip", path=_PATH) or str(Path("/usr/sbin/ip"))


def _run(*arguments: str) -> None:
    subprocess.run([_ip(), *arguments], check=True, capture_output=True)
