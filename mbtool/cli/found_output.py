"""Prints the places that mbtool find has found, and keeps them in a profile."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from mbtool.cli.console import PipeConsole
from mbtool.cli.profile_files import write
from mbtool.cli.talk import say
from mbtool.core import UsageError
from mbtool.core.moments import counted
from mbtool.devices import load_profile
from mbtool.devices.loading import profile_from_toml
from mbtool.devices.profile_template import name_for
from mbtool.values.draft import draft_profile
from mbtool.values.finding import LIKELY, ChangedPlace, FoundPlace, Wanted
from mbtool.values.keeping import point_of, with_points
from mbtool.views.found_places import LEAST_SHOWN, changes_table, places_table, wanted_title
from mbtool.views.tables import printable

if TYPE_CHECKING:
    from mbtool.workflows.find import Finder


def print_places(
    finder: Finder, wanted: Sequence[Wanted], found: Sequence[Sequence[FoundPlace]], top: int
) -> None:
    """Print the places of each number."""
    console = PipeConsole(highlight=False)
    several = len(finder.slaves.slaves) > 1
    for number, (one, places) in enumerate(zip(wanted, found, strict=True)):
        if number:
            typer.echo("")
        shown = [place for place in places[:top] if place.likelihood >= LEAST_SHOWN]
        typer.echo(printable(wanted_title(one)))
        if shown:
            console.print(places_table(shown, one.unit, several_slaves=several))
        else:
            typer.echo("in no register, in no type and scale")


def print_changes(finder: Finder, changes: Sequence[ChangedPlace]) -> None:
    """Print the values that may be the changed setting."""
    if not changes:
        typer.echo("no value is another one after it than before")
        return
    several = len(finder.slaves.slaves) > 1
    PipeConsole(highlight=False).print(changes_table(changes, several_slaves=several))


def keep_places(
    finder: Finder,
    wanted: Sequence[Wanted],
    found: Sequence[Sequence[FoundPlace]],
    keep: str,
    file: str,
) -> None:
    """Write the most likely place of each number as a point of a profile, if it is likely."""
    best = [(one, places[0]) for one, places in zip(wanted, found, strict=True) if places]
    for one, place in best:
        if place.likelihood < LIKELY:
            say(f"mbtool: {one.name or point_of(one, place)[0].name} is not kept: {_doubt(place)}")
    best = [(one, place) for one, place in best if place.likelihood >= LIKELY]
    if not best:
        say(f"mbtool: nothing is likely enough, so {keep} is not written")
        return
    slaves = {place.slave for _, place in best}
    if len(slaves) > 1:
        raise UsageError(f"--keep {keep}: the places are of {len(slaves)} slaves; add --unit WHO")
    known = [point_of(one, place) for one, place in best]
    if os.path.exists(keep):
        profile = load_profile(keep)
        text = with_points(Path(keep).read_text(encoding="utf-8"), profile, known)
        try:
            profile_from_toml(text, keep)
        except UsageError as error:
            raise UsageError(f"{error}; {keep} stays as it was") from error
        write(keep, text, overwrite=True)
    else:
        slave = finder.slave_of(next(iter(slaves)))
        text = draft_profile(slave, name_for(keep), file, known).text
        write(keep, text, overwrite=False)
    say(f"{counted(len(known), 'point')} -> {keep}")


def _doubt(place: FoundPlace) -> str:
    """Why a place is not likely, and what to do."""
    if place.outside:
        never = f"{place.outside[0]:g}"
        return (
            f"the registers never had {never} in the recording; record while the display shows it, "
            f"and give the time: {never}@TIME"
        )
    return f"its best place is only {place.likelihood:.0%} likely; give the number again, later"
