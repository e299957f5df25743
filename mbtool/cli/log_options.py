"""The options by which `sniff` writes a log."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, ClassVar

import typer

from mbtool.cli.option_groups import OptionGroup
from mbtool.cli.options import TcpPorts, TopicPerPointOption
from mbtool.cli.talk import say
from mbtool.core import LinkSpec, UsageError

if TYPE_CHECKING:
    from mbtool.cli.service import ServiceRun
    from mbtool.decode.line_timing import LineTiming
    from mbtool.logs.rotation import RotatingLog
    from mbtool.logs.writer import LogWriter
    from mbtool.workflows.live_out import LiveOut
    from mbtool.workflows.shared.checked_log import FindingsLog
    from mbtool.workflows.shared.heartbeat import StatusLog
    from mbtool.workflows.shared.recorder import Log


@dataclass(frozen=True, slots=True)
class LogOptions(OptionGroup):
    """The options --write, --rotate, --keep and those that say what is written."""

    heading: ClassVar[str] = "The log"

    write: Annotated[
        str | None,
        typer.Option("--write", "-w", metavar="FILE.mcap", help="Log all that is heard."),
    ] = None
    overwrite: Annotated[
        bool, typer.Option("--overwrite", help="Replace the log if there is one of that name.")
    ] = False
    rotate: Annotated[
        str | None,
        typer.Option(
            "--rotate",
            metavar="100MB|1h",
            help="Write FILE-0001.mcap, and go on in the next file at this size or age.",
        ),
    ] = None
    keep: Annotated[
        int | None,
        typer.Option(
            "--keep",
            metavar="N",
            min=2,
            help="With --rotate: keep the last N files, and fewer where the disk is full.",
        ),
    ] = None
    keep_around: Annotated[
        list[str] | None,
        typer.Option(
            "--keep-around",
            metavar="CODE",
            help="With --keep: keep for good the files around each case of a trouble whose code "
            "begins so, as FILE-0012-kept.mcap: the one before, its own, the next. Repeatable.",
        ),
    ] = None
    evidence_only: Annotated[
        bool,
        typer.Option(
            "--evidence-only",
            help="Log the bytes and not what they mean; reading the log decodes them.",
        ),
    ] = False
    topic_per_point: TopicPerPointOption = False
    service: Annotated[
        bool,
        typer.Option(
            "--service",
            help="Run unattended: print no rows, tell systemd how it goes, write heartbeats into "
            "the log for mbtool status, and go on behind the parts of an earlier run.",
        ),
    ] = False

    def check(self) -> None:
        """Raise UsageError if an option is without another one that it needs."""
        if self.write is None:
            for is_given, why in (
                (self.rotate, "--rotate needs a log to rotate: name one with -w FILE.mcap"),
                (self.topic_per_point,
                 "--topic-per-point is about a log: name one with -w FILE.mcap"),
                (self.evidence_only,
                 "--evidence-only needs a log to leave things out of: -w FILE.mcap"),
            ):  # fmt: skip
                if is_given:
                    raise UsageError(why)
        if self.service and self.rotate is None:
            raise UsageError(
                "--service needs a log in parts: name it with -w FILE.mcap --rotate 1h"
            )
        if self.keep is not None and self.rotate is None:
            raise UsageError("--keep needs a log of several files: name its limit with --rotate 1h")
        if self.keep_around and self.keep is None:
            raise UsageError(
                "--keep-around is about files that are removed: name how many are kept "
                "with --rotate 10m --keep 3"
            )
        if self.evidence_only and self.topic_per_point:
            raise UsageError(
                "--evidence-only logs no points, so --topic-per-point has nothing to do"
            )

    def check_path(self) -> None:
        """Raise UsageError if the log could not be created, or if its parts have no such limit."""
        from mbtool.logs import Rotation
        from mbtool.logs.opening import check_log_path

        if self.rotate is not None:
            Rotation.parse(self.rotate)
        if self.write is not None:
            check_log_path(self.write, overwrite=self.overwrite)

    def creation(
        self,
        links: Sequence[LinkSpec],
        timing: LineTiming,
        ports: TcpPorts,
        told: LiveOut,
        run: ServiceRun | None,
    ) -> Callable[[], Log] | None:
        """Return a function that creates the log of a recording; None if no log is wanted.

        `told` keeps the files of the log from around a trouble, `run` writes heartbeats into it.
        """
        from mbtool.logs import Rotation
        from mbtool.logs.opening import create_log, with_point_topics
        from mbtool.workflows.shared.checked_log import begin_checked
        from mbtool.workflows.shared.evidence_only import begin_evidence_only
        from mbtool.workflows.sniff import serial_lines

        if self.write is None:
            return None
        created: Callable[[], LogWriter | RotatingLog] = partial(
            create_log,
            self.write,
            links,
            timing.assignments,
            rotation=None if self.rotate is None else Rotation.parse(self.rotate),
            overwrite=self.overwrite,
            continues=self.service,
            evidence_only=self.evidence_only,
            keep=self.keep,
            on_full=lambda text: say(f"mbtool: {text}"),
            **ports._asdict(),
        )
        if self.keep_around:
            created = partial(told.keep_files_of, created)
        if self.topic_per_point:
            created = partial(with_point_topics, created)
        kept: Callable[[], StatusLog] = created
        if self.evidence_only:
            kept = partial(begin_evidence_only, created, links)
        beating: Callable[[], FindingsLog] = (
            kept if run is None else partial(run.with_heartbeats, kept)
        )
        if self.evidence_only:
            return beating
        return partial(begin_checked, beating, timing, serial_lines(links), ports.expected)

    def place(self) -> str:
        """Return where the log is, for the user; the options name one."""
        from mbtool.logs.rotation import parts_of

        assert self.write is not None
        if self.rotate is None:
            return place_of(self.write)
        return f"{next(iter(parts_of(Path(self.write))), self.write)} and those behind it"


def place_of(log: str) -> str:
    """Return where a log is that was written, for the user."""
    is_there = os.path.lexists(log)
    return log if is_there else f"{log}, which was removed or renamed while it was written"
