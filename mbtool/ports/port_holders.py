"""Who has a serial port open: Linux tells it of each process that one may look into."""

# Nothing is opened but folders below /proc: a port's lines must not change because somebody asks.
# What is kept is the holders of the ports asked for, and a count.

from __future__ import annotations

import os
from typing import TYPE_CHECKING

from mbtool.core.local_ports import Holder

if TYPE_CHECKING:
    from collections.abc import Collection, Iterator
    from pathlib import Path


def holders_of(devices: Collection[str], root: Path) -> tuple[dict[str, list[Holder]], int]:
    """Who holds each of these ports, and how many processes could not be looked into."""
    found: dict[str, list[Holder]] = {device: [] for device in devices}
    unseen = 0
    for process in _processes(root / "proc"):
        try:
            held = set(_open_files(process)) & found.keys()
        except PermissionError:
            unseen += not _is_of_the_kernel(process)
            continue
        except OSError:  # It has ended.
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
        except FileNotFoundError:  # It has been closed.
            continue


def _is_of_the_kernel(process: Path) -> bool:
    """Whether it is a thread of the kernel, which has no command line, or has ended."""
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
