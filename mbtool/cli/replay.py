"""mbtool replay: play one side of a recording, or both."""

from __future__ import annotations

from typing import Annotated

import typer

from mbtool.cli.option_groups import takes_groups
from mbtool.cli.options import AllowOption, DeviceOption, RawOption, SourceOptions, WhereOption
from mbtool.cli.replay_options import (
    AS_BUS,
    AS_SLAVE,
    AsMasterOptions,
    AsSlaveOptions,
    PaceOptions,
    SideOptions,
    demand_side,
)


@takes_groups
def replay(
    context: typer.Context,
    file: Annotated[
        str, typer.Argument(metavar="FILE", help="A log or a packet capture, as for decode.")
    ],
    *,
    chosen: SideOptions,
    as_slave: AsSlaveOptions,
    pace: PaceOptions,
    as_master: AsMasterOptions,
    device: DeviceOption = None,
    where: WhereOption = None,
    raw: RawOption = False,
    source: SourceOptions,
    allow: AllowOption = None,
) -> None:
    """Play one side of a recording, or both.

    As the slaves: a request gets its next recorded answer; when there is no further one, the last
    one again. Until Ctrl-C.

    As the master: recorded requests at recorded times; each answer is compared with the recorded
    one. Exit 1 when one differs.

    As the bus: every byte of both sides onto a serial line, for whoever listens there.

    At a terminal: space pauses, s or right steps, + and - or up and down change the speed, q ends.
    """
    from mbtool.cli.options import condition
    from mbtool.core import parse_link
    from mbtool.core.link_spec import ANSWERED

    side, link_text = chosen.side_and_link()
    demand_side(context, side)
    reading = source.read(device, raw=raw)
    link = parse_link(link_text, ANSWERED)
    shared = pace.shared(reading, condition(where))
    if side == AS_SLAVE:
        from mbtool.cli.replay_slave import play_as_slave
        from mbtool.ports.allowed_peers import AllowedPeers

        slave_options = as_slave.read(shared, is_loop=pace.loop)
        play_as_slave(file, link, slave_options, AllowedPeers.parse(allow or ()))
    elif side == AS_BUS:
        from mbtool.cli.replay_bus import play_as_bus

        play_as_bus(file, link, pace.as_bus(shared))
    else:
        from mbtool.cli.replay_master import play_as_master

        master_options = as_master.read(shared, is_loop=pace.loop)
        play_as_master(file, link, master_options, as_master.report, as_master.learn)
