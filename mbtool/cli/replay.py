"""mbtool replay: play the slaves, the master, or the whole bus of a recording."""

from __future__ import annotations

from typing import Annotated

import typer

from mbtool.cli import exit_codes
from mbtool.cli.connection_options import ConnectionOptions
from mbtool.cli.option_groups import with_option_groups
from mbtool.cli.options import (
    AllowOption,
    DeviceOption,
    RawOption,
    SourceOptions,
    WhereOption,
    condition,
)
from mbtool.cli.replay_options import (
    AS_BUS,
    AS_SLAVE,
    AsMasterOptions,
    AsSlaveOptions,
    PaceOptions,
    SideOptions,
    demand_side,
    one_link,
)
from mbtool.core import UsageError, parse_link
from mbtool.core.link_spec import ANSWERED


@with_option_groups
def replay(
    context: typer.Context,
    files: Annotated[
        list[str],
        typer.Argument(
            metavar="FILE",
            help="A log or a packet capture, as for decode. Several go with --learn.",
        ),
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
    connections: ConnectionOptions,
) -> None:
    """Play one side of a recording, or both.

    As the slaves: a request gets its next recorded answer; when there is no further one, the last
    one again. Until Ctrl-C. --on WHO=LINK, repeated, plays several slaves, each on a link of its
    own; --on all=tcp:127.0.0.0/24:1502 all of them.

    As the master: recorded requests at recorded times; each answer is compared with the recorded
    one. Exit 1 when one differs.

    As the bus: every byte of both sides onto a serial line, for whoever listens there.

    At a terminal: space pauses, s or right steps, + and - or up and down change the speed, q ends.
    """
    side, links = chosen.side_and_links()
    demand_side(context, side)
    reading = source.read(device, raw=raw)
    shared = pace.shared(reading, condition(where))
    file = files[0]
    if len(files) > 1 and (as_master.learn is None or as_master.report is not None):
        raise UsageError(
            f"{files[1]}: one FILE is played; several go with --as-master --learn, without --report"
        )
    if side == AS_SLAVE:
        from mbtool.cli.replay_slave import play_as_slave
        from mbtool.ports.tcp_listener import AllowedPeers

        slave_options = as_slave.read(shared, is_loop=pace.loop)
        peers = AllowedPeers.parse(allow or (), connections.read())
        play_as_slave(file, links, slave_options, peers, prints=as_slave.print_)
        return
    link = parse_link(one_link(side, links), ANSWERED)
    if side == AS_BUS:
        from mbtool.cli.replay_bus import play_as_bus

        play_as_bus(file, link, pace.as_bus(shared))
    else:
        from mbtool.cli.replay_master import play_as_master

        master_options = as_master.read(shared, is_loop=pace.loop)
        code = exit_codes.DONE
        for each in files:
            code = max(code, play_as_master(each, link, master_options, as_master))
            if code == exit_codes.INTERRUPTED:
                break
        if code:
            raise typer.Exit(code)
