"""mbtool replay: play one side of a recording."""

from __future__ import annotations

from enum import StrEnum
from typing import TYPE_CHECKING, Annotated

import typer

from mbtool.cli.options import LineOption, PortOption, RemoteOption, RtuPortOption, WhereOption

if TYPE_CHECKING:
    from mbtool.core import InputError


class MissChoice(StrEnum):
    """The values of replay.OnMiss, which would bring the protocol into every --help."""

    IMAGE = "image"
    EXCEPTION = "exception"
    SILENT = "silent"


def replay(
    file: Annotated[
        str, typer.Argument(metavar="FILE", help="A log or a packet capture, as for decode.")
    ],
    on: Annotated[
        str,
        typer.Option(
            "--on",
            metavar="LINK",
            help="Where to answer: rtu:PORT@19200-8E1, ascii:PORT@9600-7E1, tcp:HOST:PORT or "
            "rtu+tcp:HOST:PORT.",
        ),
    ],
    as_slave: Annotated[
        bool, typer.Option("--as-slave", help="Answer as the recorded slaves did.")
    ] = False,
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
            help="How fast to answer: recorded latencies are divided by this; max leaves them out.",
        ),
    ] = "1.0",
    where: WhereOption = None,
    raw: Annotated[
        bool, typer.Option("--raw", help="Decode a log's evidence afresh before playing it.")
    ] = False,
    port: PortOption = None,
    rtu_port: RtuPortOption = None,
    link: LineOption = None,
    allow_remote: RemoteOption = False,
) -> None:
    """Answer a live master as a recording's slaves did, until Ctrl-C.

    A request gets its next recorded answer; when there is no further one, the last one again.
    """
    from mbtool.cli.options import condition, file_line, tcp_ports
    from mbtool.cli.serve import serve
    from mbtool.cli.talk import say
    from mbtool.core import UsageError, parse_link
    from mbtool.core.link_spec import ANSWERED
    from mbtool.replay import OnMiss
    from mbtool.slave import slave_link
    from mbtool.workflows.reading import ReadingOptions
    from mbtool.workflows.replaying import read_recording, recorded_slave

    if not as_slave:
        raise UsageError("say which side to play: --as-slave")
    where_to_answer = slave_link(parse_link(on, ANSWERED))
    factor = _speed(speed)
    wanted = condition(where)

    def on_cut(error: InputError) -> None:
        say(f"mbtool: {error}; playing what is there")

    ports, any_port = tcp_ports(port)
    options = ReadingOptions(
        ports=ports, rtu_ports=rtu_port or (), any_port=any_port, line=file_line(link), raw=raw
    )
    recording = read_recording(file, options, wanted, on_cut, say)
    shell = recorded_slave(
        recording,
        where_to_answer,
        on_miss=OnMiss(on_miss.value),
        speed=factor,
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


def _speed(text: str) -> float | None:
    from mbtool.core import UsageError

    if text == "max":
        return None
    try:
        factor = float(text)
    except ValueError:
        factor = 0.0
    if not 0 < factor < float("inf"):
        raise UsageError(f"--speed {text!r}: write a factor more than 0, or max")
    return factor
