"""mbtool doctor: print what is missing on this machine, and the command that mends it."""

from __future__ import annotations

import json
from dataclasses import asdict
from typing import Annotated

import typer

from mbtool.cli import exit_codes
from mbtool.cli.talk import say
from mbtool.core.moments import counted
from mbtool.version import __version__


def doctor(
    as_json: Annotated[
        bool, typer.Option("--json", help="Print one JSON object with all checks.")
    ] = False,
) -> None:
    """Say what this machine lacks, and the command that mends it.

    Python, extras, permissions, ports and their timing, Wireshark, the terminal. Nothing is opened
    and nothing is changed. Exit 1 if something is broken; an extra that is not there is no fault.
    """
    import shutil
    import sys

    from mbtool.cli.console import PipeConsole
    from mbtool.ports.local_ports import local_ports
    from mbtool.sources.interface import capture_trouble
    from mbtool.views.machine_checks import print_machine_checks
    from mbtool.workflows.doctor import CheckState, Screen, machine_checks

    size = shutil.get_terminal_size()
    encoding = sys.stdout.encoding or "ascii"
    screen = Screen(sys.stdout.isatty(), size.columns, size.lines, encoding)
    checks = list(machine_checks(local_ports(), capture_trouble(), screen))
    broken = sum(one.state is CheckState.BROKEN for one in checks)
    missing = sum(one.state is CheckState.MISSING for one in checks)
    if as_json:
        document = {
            "mbtool": __version__,
            "system": sys.platform,
            "broken": broken,
            "missing": missing,
            "checks": [asdict(one) for one in checks],
        }
        typer.echo(json.dumps(document, indent=2))
    else:
        rows = [(str(one.state), one.name, one.found, one.remedy) for one in checks]
        print_machine_checks(PipeConsole(), rows)
        first = f"{counted(broken, 'thing')} broken (!!)" if broken else "nothing is broken"
        say(f"{first}; {counted(missing, 'thing')} missing (-) that only some uses need")
    if broken:
        raise typer.Exit(exit_codes.NO)
