"""Creates the log of a capture and records the links, devices and profiles in it."""

from __future__ import annotations

import platform
import re
import shlex
import sys
from collections.abc import Callable, Sequence
from pathlib import Path, PurePath

from mbtool.core import InterfaceLink, LinkSpec, TapLink, UsageError
from mbtool.devices import Assignments, profile_to_json
from mbtool.logs.creating import check_path
from mbtool.logs.layout import EVIDENCE_ONLY
from mbtool.logs.links import ANY_PORT, PORTS, RTU_PORTS, SPEC
from mbtool.logs.rotation import RotatingLog, Rotation
from mbtool.logs.writer import LogWriter

_OTHER_SUFFIXES = frozenset({".pcap", ".pcapng", ".jsonl", ".csv"})
"""Suffixes of other file formats, which the file of a log must not have."""


def create_log(
    path: str,
    links: Sequence[LinkSpec],
    assignments: Assignments,
    *,
    ports: Sequence[int] = (),
    rtu_ports: Sequence[int] = (),
    any_port: bool = False,
    rotation: Rotation | None = None,
    overwrite: bool = False,
    continues: bool = False,
    evidence_only: bool = False,
    keep: int | None = None,
    on_full: Callable[[str], None] = lambda _: None,
) -> LogWriter | RotatingLog:
    """Create a log, and write to it everything that is needed to decode its captured bytes again.

    `ports`, `rtu_ports` and `any_port` are the TCP ports that the run decodes on interfaces. With
    `rotation` the result is a RotatingLog; `continues`, `keep` and `on_full` are arguments of its
    constructor. With `overwrite` an existing file is replaced. With `evidence_only` the log is
    marked as holding captured bytes but no transactions, so that its readers decode it.

    Raises UsageError if the file cannot be created or has the suffix of another format, OutputError
    if another recorder has it open.
    """
    _check_suffix(path)
    capture = {
        "host": platform.node(),
        "system": platform.platform(),
        "command": typed_command(),
        "clock": "the host's system clock at the start, plus the time that passed since, "
        "UTC nanoseconds, read right after each read",
    }
    if evidence_only:
        capture[EVIDENCE_ONLY] = "true"
    log: LogWriter | RotatingLog
    if rotation is None:
        log = LogWriter(path, capture=capture, replace=overwrite)
    else:
        log = RotatingLog(
            path,
            rotation,
            capture=capture,
            replace=overwrite,
            continues=continues,
            keep=keep,
            on_full=on_full,
        )
    for link in links:
        settings = {SPEC: str(link)}
        if isinstance(link, InterfaceLink):
            named: list[int | str] = [*ports, *([ANY_PORT] if any_port else [])]
            settings |= {PORTS: _listed(named), RTU_PORTS: _listed(rtu_ports)}
        elif isinstance(link, TapLink) and link.target.port in rtu_ports:
            settings[RTU_PORTS] = str(link.target.port)
        if isinstance(link, TapLink) and link.read_only:
            settings["read_only"] = "true"
        if isinstance(link, TapLink) and link.tls_sides:
            settings["tls"] = " ".join(link.tls_sides)
        log.add_link(link.name, settings)
    for assignment in assignments:
        log.add_device(str(assignment.who), assignment.profile.name)
    for profile in assignments.profiles:
        log.add_profile(profile.name, profile_to_json(profile))
    return log


def with_point_topics(create: Callable[[], LogWriter | RotatingLog]) -> LogWriter | RotatingLog:
    """Call `create`, and return its log, set to write each point to a topic of its own as well.

    A point is a named value of a device.
    """
    log = create()
    log.give_points_topics()
    return log


def check_log_path(path: str, *, overwrite: bool = False) -> None:
    """Raise UsageError if `create_log` could not create a log at this path; create nothing."""
    if path in ("", "-"):
        raise UsageError(f"{path!r}: a log needs a file; name one, for example site.mcap")
    _check_suffix(path)
    check_path(Path(path), replace=overwrite)


def typed_command() -> str:
    """Return the command line of this program, without the passwords of URLs in it."""
    command = shlex.join(["mbtool", *sys.argv[1:]])
    return re.sub(r"(://[^/:@\s]*):[^/@\s]*@", r"\1:***@", command)


def _check_suffix(path: str) -> None:
    name = PurePath(path)
    if name.suffix.lower() in _OTHER_SUFFIXES:
        raise UsageError(f"{path}: a log is an MCAP file: name it {name.with_suffix('.mcap')}")


def _listed(ports: Sequence[int | str]) -> str:
    return " ".join(map(str, ports))
