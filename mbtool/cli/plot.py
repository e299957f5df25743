"""mbtool plot: show values over time, in the terminal or as a picture."""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence
from importlib.util import find_spec
from typing import TYPE_CHECKING, Annotated

import typer

from mbtool.cli.option_groups import with_option_groups
from mbtool.cli.options import (
    CaptureOptions,
    EndOption,
    GuessedTypesOption,
    OverwriteOption,
    StartOption,
    WhereOption,
    condition,
    given_types,
)
from mbtool.cli.output_path import demand_new, demand_other_file, named_file
from mbtool.cli.progress import with_progress
from mbtool.cli.talk import say, say_if_interrupted
from mbtool.core import InputError, UsageError
from mbtool.core.extras import missing_extra
from mbtool.core.moments import counted
from mbtool.workflows.shared.named_files import named_files
from mbtool.workflows.shared.time_window import TimeWindow

if TYPE_CHECKING:
    from rich.console import Console

    from mbtool.views.plot_lines import PlotSize
    from mbtool.views.statistics_columns import StyledLine
    from mbtool.workflows.plot import PlottedValues

_SUFFIXES = {".png": "png", ".svg": "svg", ".pdf": "pdf"}
_CAPTURE_SUFFIXES = (".pcap", ".pcapng", ".mcap", ".sr", ".gz", ".zst")
_PIPE_ROWS = 8


@with_option_groups
def plot(
    arguments: Annotated[
        list[str],
        typer.Argument(
            metavar="FILE|REFERENCE",
            help="Captures and logs, as for decode; then what to plot: HR400001..400004 or the "
            "name of a point, as the device's manual writes them, or 'holding 0..3', 'coil 3' by "
            "the address on the wire. Without any, what there is to plot is listed.",
        ),
    ],
    *,
    capture: CaptureOptions,
    types: GuessedTypesOption = None,
    where: WhereOption = None,
    start: StartOption = None,
    end: EndOption = None,
    output: Annotated[
        str | None,
        typer.Option("--output", "-o", metavar="OUT", help="Write a picture: .png, .svg or .pdf."),
    ] = None,
    overwrite: OverwriteOption = False,
    as_json: Annotated[
        bool, typer.Option("--json", help="Print the values and their times as JSON.")
    ] = False,
) -> None:
    """Plot values over time, in the terminal or as a picture.

    A value holds until the next one is read or written. Pictures need mbtool[plot].
    """
    from mbtool.cli.output import demand_standard_output, say_if_empty
    from mbtool.workflows.plot import PlotRun

    files, texts = _files_and_references(arguments)
    files = named_files(files)
    if output is not None and not texts:
        raise UsageError("name what to plot behind the files; without --output they are listed")
    if output is not None and as_json:
        raise UsageError("--output writes a picture; --json goes to standard output")
    demand_other_file(files, output)
    path = named_file(output)
    picture = None if output is None else _picture(output)
    if picture is not None:
        _demand_matplotlib()
    else:
        demand_standard_output()
    window = TimeWindow.parse(start, end)
    given, guesses = given_types(types)
    options = capture.read(given)
    run = PlotRun(files, options, texts, window, condition(where), guesses=guesses)
    run.reading.demand_files()
    demand_new(path, overwrite=overwrite)
    with say_if_interrupted():
        values = run.take(with_progress)
    if path is not None and picture is not None:
        _write(values, path, picture, overwrite=overwrite)
    else:
        _print(values, files, texts, as_json=as_json)
    for remark in run.reading.remarks:
        say(remark)
    say_if_empty(run.reading)
    if not values.series and not as_json and run.reading.why_empty is None:
        say("no value was read or written")
    if values.left_out:
        from mbtool.values.values import MAX_LEFT_OUT

        least = "at least " if values.left_out >= MAX_LEFT_OUT else ""
        say(f"{least}{values.left_out:,} more values are left out; name those that you want")
    if window.why_empty is not None:
        say(window.why_empty)
    if run.error is not None:
        raise run.error


def _files_and_references(arguments: Sequence[str]) -> tuple[list[str], list[str]]:
    """Divide the arguments into files and references to plot.

    The first argument is always a file. The references begin with the first of the others that is
    no existing file. Raises InputError if one of the others has the suffix of a capture and does
    not exist, UsageError if it does exist.
    """
    at = next((at for at, one in enumerate(arguments) if at and not os.path.exists(one)), None)
    texts = [] if at is None else list(arguments[at:])
    for one in texts:
        if os.path.splitext(one)[1].lower() in _CAPTURE_SUFFIXES:
            if not os.path.exists(one):
                raise InputError(f"{one}: there is no such file")
            raise UsageError(f"{one}: name all files first, then what to plot")
    return list(arguments[:at]), texts


def _picture(output: str) -> str:
    """Return the picture format that the suffix of a file names: `png`, `svg` or `pdf`.

    Raises UsageError for another suffix.
    """
    found = _SUFFIXES.get(os.path.splitext(output)[1].lower())
    if found is None:
        raise UsageError(f"{output}: a picture ends in {', '.join(_SUFFIXES)}")
    return found


def _demand_matplotlib() -> None:
    if find_spec("matplotlib") is None:
        raise missing_extra("a picture", "plot")


def _write(values: PlottedValues, path: str, format_: str, *, overwrite: bool) -> None:
    from mbtool.cli.output import as_output_error, opened
    from mbtool.views.plot_image import write_image

    series = list(values.series.items())
    if not series:
        return
    with opened(path, lambda: None, overwrite=overwrite) as (file, name), as_output_error(name):
        write_image(series, values.begin_ns, values.end_ns, file.buffer, format_)
        file.flush()
    say(f"{counted(len(series), 'value')} -> {path}")


def _print(
    values: PlottedValues, files: Sequence[str], texts: Sequence[str], *, as_json: bool
) -> None:
    from rich.text import Text

    from mbtool.cli.console import PipeConsole
    from mbtool.cli.output import as_output_error
    from mbtool.sources.files import shown_name
    from mbtool.views.plot_documents import values_json, values_lines
    from mbtool.views.plot_lines import plot_lines

    console = PipeConsole(file=sys.stdout)
    changing = {key: one for key, one in values.series.items() if one.changes}
    charts = sum(not one.bit for one in changing.values())
    size = _size(console, charts, len(values.series) + len(changing) - charts)
    lines: Sequence[StyledLine] = ()
    with as_output_error("standard output"):
        if as_json:
            sys.stdout.write(values_json(values.series, [*map(shown_name, files)], values.left_out))
        elif not values.series:
            pass
        elif texts:
            series = list(values.series.items())
            lines = plot_lines(series, values.begin_ns, values.end_ns, size)
        elif changing:
            width = console.width if console.is_terminal else None
            lines = values_lines(changing, width, unicode=size.unicode)
        for line in lines:
            console.print(Text(line.text, line.style), soft_wrap=True)
        sys.stdout.flush()
    if not texts and not as_json and (constant := len(values.series) - len(changing)):
        never = "" if changing else "nothing to plot: "
        say(f"{never}{counted(constant, 'value', ',')} never changed; --json has them")


def _size(console: Console, charts: int, others: int) -> PlotSize:
    """Return the size at which `charts` charts and `others` other lines fill the terminal.

    On a pipe, charts have a fixed height.
    """
    from mbtool.views.plot_lines import LEAST_ROWS, MOST_ROWS, PlotSize

    unicode = console.encoding.startswith("utf") and os.environ.get("TERM") != "dumb"
    rows = _PIPE_ROWS
    if console.is_terminal:
        room = (console.height - 3 - others) // max(charts, 1)
        rows = min(max(room, LEAST_ROWS), MOST_ROWS)
    return PlotSize(console.width, rows, unicode)
