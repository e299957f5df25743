"""The command line: mbtool COMMAND."""

# Each command stands in a file of its own, imports what it needs when it runs, asks a workflow and
# shows what comes. Errors become one line and an exit code here and nowhere else.

from __future__ import annotations

import os
import sys
from typing import Annotated

import typer

from mbtool import __version__
from mbtool.cli import exit_codes
from mbtool.cli.decode import decode
from mbtool.cli.demo import demo
from mbtool.cli.devices import devices
from mbtool.cli.line import line
from mbtool.cli.replay import replay
from mbtool.cli.slave import slave
from mbtool.cli.sniff import sniff
from mbtool.core import InputError, LinkError, MbtoolError

app = typer.Typer(
    name="mbtool",
    help="Capture, decode and replay Modbus: serial lines, TCP, and the devices' own words.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)
for command in (sniff, decode, replay, slave, devices, line, demo):
    app.command()(command)


def _version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"mbtool {__version__}")
        raise typer.Exit


@app.callback()
def _root(
    version: Annotated[
        bool, typer.Option("--version", help="Print the version.", callback=_version, is_eager=True)
    ] = False,
) -> None:
    pass


def main() -> None:
    """Run the command line and exit with its code."""
    sys.exit(run(sys.argv[1:]))


def run(arguments: list[str]) -> int:
    """Run one command; the answer is its exit code."""
    try:
        code = app(arguments, prog_name="mbtool", standalone_mode=False)
        sys.stdout.flush()
    except typer.TyperException as error:
        return _fail(error.format_message(), exit_codes.USAGE)
    except (InputError, LinkError) as error:
        return _fail(str(error), exit_codes.UNREADABLE)
    except MbtoolError as error:
        return _fail(str(error), exit_codes.USAGE)
    except (KeyboardInterrupt, typer.Abort):
        return exit_codes.INTERRUPTED
    except BrokenPipeError:
        # Whoever read the output has seen enough. The interpreter must not flush into the pipe.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return exit_codes.DONE
    return code if isinstance(code, int) else exit_codes.DONE


def _fail(message: str, code: int) -> int:
    """One line to standard error."""
    line = " ".join(message.split())
    print(f"mbtool: {line}", file=sys.stderr)  # noqa: T201 - this is where errors are told
    return code
