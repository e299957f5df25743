"""Finds the processes that have a serial port open. Linux only."""

# /proc/PID/fd has a link for each open file. Only folders below /proc are opened, never a port, as
# opening a port could change its control lines. Only root can look into the processes of other
# users; the processes that cannot be looked into are counted.

from __future__ import annotations

import os
from typing import TYPE_CHECKING

from mbtool.core.local_ports import Holder

if TYPE_CHECKING:
    from collections.abc import Collection, Iterator
    from pathlib import Path


def holders_of(devices: Collection[str], root: Path) -> tuple[dict[str, list[Holder]], int]:
    """Return the processes that have each port open, and the number of processes that may not be
    inspected.

    `devices` are the paths of the ports, such as /dev/ttyUSB0; they become the keys of the returned
    dictionary. `root` is the folder that contains /proc.
    """
    found: dict[str, list[Holder]] = {device: [] for device in devices}
    unseen = 0
    for process in _processes(root / "proc"):
        try:
            held = set(_open_files(process)) & found.keys()
        except PermissionError:
            unseen += not _is_of_the_kernel(process)
            continue
        except OSError:  # The process has ended.
            continue
        for device in held:
            found[device].append(Holder(int(process.name), _command(process)))
    for holders in found.values():
        holders.sort(key=lambda holder: holder.pid)
    return found, unseen


def _processes(proc: Path) -> Iterator[Path]:
    try:
        names = os.listdir(proc)
    except OSError:
        return
    yield from (proc / name for name in names if name.isdecimal())


def _open_files(process: Path) -> Iterator[str]:
    folder = process / "fd"
    for name in os.listdir(folder):
        try:
            yield os.readlink(folder / name)
        except FileNotFoundError:  # The process has closed the file.
            continue


def _is_of_the_kernel(process: Path) -> bool:
    """True if a process is a kernel thread or has ended: neither has a command line."""
    try:
        return not (process / "cmdline").read_bytes()
    except PermissionError:
        return False
    except OSError:
        return True


def _command(process: Path) -> str:
    try:
        return (process / "comm").read_text(errors="replace").strip()
    except OSError:
        return "process"
