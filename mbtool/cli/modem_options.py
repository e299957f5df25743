"""The options for the modem lines DTR and RTS of serial ports."""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import StrEnum
from typing import TYPE_CHECKING, Annotated

import typer

from mbtool.cli.option_groups import OptionGroup

if TYPE_CHECKING:
    from collections.abc import Sequence

    from mbtool.core import LinkSpec


class LineChoice(StrEnum):
    """The values of --dtr and --rts."""

    KEEP = "keep"
    OFF = "off"


@dataclass(frozen=True, slots=True)
class ModemOptions(OptionGroup):
    """The options --dtr and --rts: the state of each when a serial port is opened to listen."""

    dtr: Annotated[
        LineChoice | None,
        typer.Option(
            "--dtr",
            help="The kernel raises DTR when a serial port is opened, and drops it at the end. "
            "off: drop it right after the opening; keep: do not drop it at the end.",
        ),
    ] = None
    rts: Annotated[LineChoice | None, typer.Option("--rts", help="The same for RTS.")] = None

    def on(self, links: Sequence[LinkSpec]) -> list[LinkSpec]:
        """Return the links, with the chosen states of DTR and RTS in the serial lines.

        Raises UsageError if states are chosen but no link is a serial line.
        """
        from mbtool.core import SerialLink, UsageError
        from mbtool.core.serial_format import ModemLine, ModemLines

        chosen = ModemLines(*(ModemLine(one or ModemLine.RAISED) for one in (self.dtr, self.rts)))
        if chosen != ModemLines() and not any(isinstance(link, SerialLink) for link in links):
            raise UsageError("--dtr and --rts are for serial lines; none of the links is one")
        return [
            replace(link, modem_lines=chosen) if isinstance(link, SerialLink) else link
            for link in links
        ]
