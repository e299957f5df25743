"""mbtool convert: convert captures and logs into each other."""

from __future__ import annotations

from pathlib import PurePath
from typing import TYPE_CHECKING, Annotated

import typer

from mbtool.cli.option_groups import with_option_groups
from mbtool.cli.options import (
    FORMATS,
    DeviceOption,
    EndOption,
    EventChoice,
    EventsOption,
    SilenceOptions,
    SourceOptions,
    StartOption,
    TopicPerPointOption,
    WhereOption,
    condition,
)
from mbtool.cli.output_file import report_kept, report_left
from mbtool.cli.output_path import demand_other_file
from mbtool.cli.progress import with_progress
from mbtool.cli.talk import say
from mbtool.core import UsageError
from mbtool.core.moments import counted
from mbtool.workflows.shared.named_files import named_files
from mbtool.workflows.shared.time_window import TimeWindow

if TYPE_CHECKING:
    from mbtool.workflows.convert import Conversion
    from mbtool.workflows.shared.pcapng_output import Converted


@with_option_groups
def convert(
    files: Annotated[
        list[str],
        typer.Argument(
            metavar="FILE",
            help="Captures, logs (.mcap), bytes of a serial line, or .jsonl. The last FILE is "
            "the one to write: .pcapng (for Wireshark, serial lines, too), .pcap, .mcap, "
            f"{', '.join(FORMATS)}. Several become one, in the order of time; with {{device}} in "
            "its name each slave gets a file, with its whole TCP connections.",
        ),
    ],
    *,
    overwrite: Annotated[
        bool, typer.Option("--overwrite", help="Replace the file to write if it exists.")
    ] = False,
    start: StartOption = None,
    end: EndOption = None,
    where: WhereOption = None,
    connections: Annotated[
        bool,
        typer.Option(
            "--connections",
            help="With --start, --end and --where: all packets of the TCP connections that they "
            "choose, with handshakes and acknowledgements.",
        ),
    ] = False,
    anonymous: Annotated[
        bool,
        typer.Option(
            "--anonymous",
            help="Replace addresses, MACs, names of hosts and ports, texts in registers; "
            "shift times; leave out comments and all that is no Modbus.",
        ),
    ] = False,
    key: Annotated[
        str | None,
        typer.Option(
            metavar="FILE",
            help="With --anonymous: the same key replaces the same by the same. Without it, "
            "the key is random.",
        ),
    ] = None,
    units: Annotated[
        bool, typer.Option("--units", help="With --anonymous: replace unit ids, too.")
    ] = False,
    device: DeviceOption = None,
    topic_per_point: TopicPerPointOption = False,
    events: EventsOption = None,
    source: SourceOptions,
    silences: SilenceOptions,
) -> None:
    """Convert captures and logs into each other; join and cut them.

    Packets of a network stay as they were captured. Frames of serial lines and taps become packets
    that Wireshark shows as Modbus without any setting; converted back, they are the same bytes.
    """
    import re

    from mbtool.workflows.convert import CAPTURE_SUFFIXES, DEVICE, Conversion

    if len(files) < 2:
        raise UsageError("name what to read, then the file to write: convert A.mcap B.pcapng")
    *paths, out = files
    paths = named_files(paths)
    if (place := re.search(r"\{\w*\}", out)) and place[0] != DEVICE:
        raise UsageError(f"{out}: {place[0]} stands for nothing; {DEVICE} is the name of the slave")
    if DEVICE in out and (
        PurePath(out).suffix.lower() not in CAPTURE_SUFFIXES or topic_per_point or anonymous
    ):
        raise UsageError(
            f"{DEVICE} goes with {', '.join(sorted(CAPTURE_SUFFIXES))}, "
            "and not with --anonymous and --topic-per-point"
        )
    if topic_per_point and PurePath(out).suffix.lower() != ".mcap":
        raise UsageError("--topic-per-point goes with a log: name the last FILE .mcap")
    suffixes = (*sorted(CAPTURE_SUFFIXES), *FORMATS)
    if out != "-" and PurePath(out).suffix.lower() not in suffixes:
        raise UsageError(f"{out}: its suffix names no format; let it end in {', '.join(suffixes)}")
    demand_other_file(paths, out)
    fits = None if where is None else condition(where)
    options = source.read(device, silences=silences)
    window = TimeWindow.parse(start, end)
    conversion = Conversion(paths, options, window, fits, with_progress, connections=connections)
    if not anonymous:
        if key is not None or units:
            raise UsageError("--key and --units go with --anonymous")
        _convert(conversion, out, events, overwrite, topic_per_point)
        return
    from mbtool.workflows.anonymise import anonymous_conversion, read_key
    from mbtool.workflows.shared.anonymous_packets import AnonymousChoice

    with anonymous_conversion(
        conversion, read_key(key), AnonymousChoice(units), with_progress
    ) as copy:
        _convert(copy, out, events, overwrite, topic_per_point)
    conversion.demand_whole()


def _convert(
    conversion: Conversion,
    out: str,
    events: EventChoice | None,
    overwrite: bool,
    topic_per_point: bool,
) -> None:
    from mbtool.workflows.convert import CAPTURE_SUFFIXES, DEVICE

    if DEVICE in out:
        _write_each(conversion, out, overwrite=overwrite)
    elif PurePath(out).suffix.lower() not in CAPTURE_SUFFIXES:
        _write_records(conversion, out, events, overwrite=overwrite)
    elif events is not None:
        raise UsageError("--events goes with .jsonl")
    else:
        with report_left(out), report_kept(out):
            done = conversion.write(out, overwrite=overwrite, topic_per_point=topic_per_point)
        _say_written(done, out)
        if topic_per_point and not done.points:
            say("no point has a name, so none has a topic; name the devices: --device WHO=PROFILE")
    for remark in conversion.remarks:
        say(remark)
    conversion.demand_whole()


def _write_each(conversion: Conversion, out: str, *, overwrite: bool) -> None:
    """Write a file for each slave."""
    files = 0
    for path, done in conversion.write_each(out, overwrite=overwrite):
        _say_written(done, path)
        files += 1
    if not files:
        say("no transaction, so there is no slave to write a file of")


def _say_written(done: Converted, out: str) -> None:
    """Print what was written to the file `out`."""
    parts = (
        (done.packets, "packet"),
        (done.reads, "read"),
        (done.transactions, "transaction"),
    )
    texts = [counted(count, word) for count, word in parts if count]
    say(f"{', '.join(texts) or 'nothing'} -> {out}")


def _write_records(
    conversion: Conversion, out: str, events: EventChoice | None, *, overwrite: bool
) -> None:
    from mbtool.cli.output import open_output

    with open_output(
        out, None, events, lambda _: None, lambda _: True, overwrite=overwrite
    ) as output:
        for record in conversion.records():
            output.add(record)
        if output.is_empty:
            conversion.demand_whole()
