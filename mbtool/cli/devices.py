"""mbtool devices: the built-in profiles, or one in full."""

from __future__ import annotations

from typing import Annotated

import typer


def devices(
    name: Annotated[
        str | None,
        typer.Argument(metavar="NAME", help="A profile's name, or the path of a TOML file."),
    ] = None,
) -> None:
    """List the device profiles, or show one in full."""
    from mbtool.cli.console import PipeConsole
    from mbtool.devices import builtin_profiles, load_profile
    from mbtool.views.profile import profile_list, profile_page

    console = PipeConsole()
    if name is None:
        console.print(profile_list([load_profile(one) for one in builtin_profiles()]))
    else:
        console.print(profile_page(load_profile(name)))
