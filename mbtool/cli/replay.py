"""mbtool replay: play one side of a recording."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from mbtool.cli.options import (
    DeviceOption,
    LineOption,
    PortOption,
    RemoteOption,
    RtuPortOption,
    WhereOption,
)

if TYPE_CHECKING:
    from fractions import Fraction

    from mbtool.core import InputError
    from mbtool.workflows.reading import ReadingOptions
    from mbtool.workflows.where import Where


class MissChoice(StrEnum):
    """The values of replay.OnMiss, which would bring the protocol into every --help."""

    IMAGE = "image"
    EXCEPTION = "exception"
    SILENT = "silent"


def replay(
    file: Annotated[
        str, typer.Argument(metavar="FILE", help="A log or a packet capture, as for decode.")
    ],
    as_slave: Annotated[
        bool, typer.Option("--as-slave", help="Answer a live master as the recorded slaves did.")
    ] = False,
    as_master: Annotated[
        bool,
        typer.Option(
            "--as-master", help="Ask a live slave what was recorded, and compare its answers."
        ),
    ] = False,
    on: Annotated[
        str | None,
        typer.Option(
            "--on",
            metavar="LINK",
            help="Where to answer as the slave: rtu:PORT@19200-8E1, ascii:PORT@9600-7E1, "
            "tcp:HOST:PORT or rtu+tcp:HOST:PORT.",
        ),
    ] = None,
    to: Annotated[
        str | None,
        typer.Option("--to", metavar="LINK", help="Where the slave is that is asked, likewise."),
    ] = None,
    on_miss: Annotated[
        MissChoice,
        typer.Option(
            "--on-miss",
            help="What a request gets that was never recorded: an answer from the registers as "
            "they were at that moment of the recording, an exception, or silence.",
        ),
    ] = MissChoice.IMAGE,
    speed: Annotated[
        str,
        typer.Option(
            "--speed",
            metavar="FACTOR|max",
            help="How fast: recorded times and latencies are divided by this; max leaves them out.",
        ),
    ] = "1.0",
    ignore: Annotated[
        list[str] | None,
        typer.Option(
            "--ignore",
            metavar="RANGE",
            help="As the master: registers whose values may differ, HR400010..400020 as the "
            "device's manual writes them, or 'holding 9..19'. Repeatable.",
        ),
    ] = None,
    ignore_from: Annotated[
        list[Path] | None,
        typer.Option(
            "--ignore-from", metavar="FILE", help="The same, from a file with a range in each line."
        ),
    ] = None,
    learn: Annotated[
        Path | None,
        typer.Option(
            "--learn",
            metavar="FILE",
            help="As the master: take registers that differ for ones that may, and add them to "
            "FILE for --ignore-from.",
        ),
    ] = None,
    timeout: Annotated[
        float,
        typer.Option(
            "--timeout",
            metavar="S",
            min=0.001,
            max=3600,
            help="As the master: how long to wait for an answer, in seconds.",
        ),
    ] = 1.0,
    latency_tolerance: Annotated[
        float | None,
        typer.Option(
            "--latency-tolerance",
            metavar="PERCENT",
            min=0,
            max=100_000,
            help="As the master: how much longer than recorded answers may take (median and 95th "
            "percentile). [default: any time]",
        ),
    ] = None,
    report: Annotated[
        Path | None,
        typer.Option(
            "--report",
            metavar="FILE",
            help="As the master: write what differs, .json or JUnit .xml.",
        ),
    ] = None,
    device: DeviceOption = None,
    where: WhereOption = None,
    raw: Annotated[
        bool, typer.Option("--raw", help="Decode a log's evidence afresh before playing it.")
    ] = False,
    port: PortOption = None,
    rtu_port: RtuPortOption = None,
    link: LineOption = None,
    allow_remote: RemoteOption = False,
) -> None:
    """Play one side of a recording.

    As the slaves: a request gets its next recorded answer; when there is no further one, the last
    one again. Until Ctrl-C.

    As the master: recorded requests at recorded times; each answer is compared with the recorded
    one. Exit 1 when one differs.
    """
    from mbtool.cli.options import assignments, condition, file_line, tcp_ports
    from mbtool.core import UsageError
    from mbtool.workflows.reading import ReadingOptions

    if as_slave == as_master:
        raise UsageError("say which side to play: --as-slave --on LINK, or --as-master --to LINK")
    needed, other = ("--on", to) if as_slave else ("--to", on)
    if (on if as_slave else to) is None or other is not None:
        raise UsageError(f"{'--as-slave' if as_slave else '--as-master'} goes with {needed} LINK")
    ports, any_port = tcp_ports(port)
    reading = ReadingOptions(
        assignments=assignments(device),
        ports=ports,
        rtu_ports=rtu_port or (),
        any_port=any_port,
        line=file_line(link),
        raw=raw,
    )
    wanted = condition(where)
    rate = _rate(speed)
    if on is not None:
        _as_slave(file, on, reading, wanted, on_miss, rate, allow_remote=allow_remote)
        return
    from mbtool.cli.replay_master import play_as_master, ranges_of
    from mbtool.core import parse_link
    from mbtool.core.link_spec import ANSWERED
    from mbtool.replay import Tolerance
    from mbtool.workflows.mastering import MasterOptions

    tolerance = None if latency_tolerance is None else Tolerance(share=latency_tolerance / 100)
    options = MasterOptions(
        reading=reading,
        wanted=wanted,
        rate=rate,
        timeout_ns=round(timeout * 1e9),
        ignore=[*(ignore or ()), *ranges_of(ignore_from or ())],
        learns=learn is not None,
        tolerance=tolerance,
    )
    play_as_master(file, parse_link(to or "", ANSWERED), options, report, learn)


def _as_slave(
    file: str,
    on: str,
    reading: ReadingOptions,
    wanted: Where,
    on_miss: MissChoice,
    rate: Fraction | None,
    *,
    allow_remote: bool,
) -> None:
    from mbtool.cli.serve import serve
    from mbtool.cli.talk import say
    from mbtool.core import parse_link
    from mbtool.core.link_spec import ANSWERED
    from mbtool.replay import OnMiss
    from mbtool.slave import slave_link
    from mbtool.workflows.replaying import read_recording, recorded_slave

    where_to_answer = slave_link(parse_link(on, ANSWERED))

    def on_cut(error: InputError) -> None:
        say(f"mbtool: {error}; playing what is there")

    recording = read_recording(file, reading, wanted, on_cut, say)
    shell = recorded_slave(
        recording,
        where_to_answer,
        on_miss=OnMiss(on_miss.value),
        speed=None if rate is None else float(rate),
        allow_remote=allow_remote,
    )
    requests = (
        "1 request"
        if len(recording.answers) == 1
        else (f"{len(recording.answers)} different requests")
    )
    units = "unit" if len(recording.units) == 1 else "units"
    numbers = ", ".join(map(str, sorted(recording.units)))
    serve(shell, f"{file}: {requests} to {units} {numbers}")


def _rate(text: str) -> Fraction | None:
    from fractions import Fraction

    from mbtool.core import UsageError

    if text == "max":
        return None
    try:
        rate = Fraction(text)
    except (ValueError, ZeroDivisionError):
        rate = Fraction(0)
    if rate <= 0 or len(text) > 20:
        raise UsageError(f"--speed {text!r}: write a factor more than 0, or max")
    return rate
