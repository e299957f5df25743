"""Several shells that are started and stopped together."""

from __future__ import annotations

import pytest

from mbtool.core import LinkError, TcpLink, parse_link
from mbtool.master.links import open_master
from mbtool.modbus import Response
from mbtool.slave.shells import TcpSlave
from mbtool.slave.shells.opening import ShellGroup
from tests.slave.scripted import Scripted
from tests.sources.live_helpers import MASTER_TIMEOUT_NS
from tests.workflows.bench import ANY
from tests.workflows.evidence import READ, VALUES


def _slave() -> TcpSlave:
    return TcpSlave(TcpLink(ANY), Scripted(lambda _unit, _pdu: Response(VALUES)))


def test_all_answer_while_the_context_is_open_and_none_afterwards() -> None:
    slaves = [_slave(), _slave()]
    with ShellGroup(slaves) as group:
        assert group.place == "2 links"
        links = [parse_link(slave.place) for slave in slaves]
        for link in links:
            with open_master(link, MASTER_TIMEOUT_NS) as master:
                assert master.ask(1, READ) == VALUES
        group.wait(0)
        assert (group.turned_away, group.notes()) == (0, [])
    for link in links:
        with pytest.raises(LinkError, match="cannot be reached"):
            open_master(link, MASTER_TIMEOUT_NS)


def test_a_group_of_one_is_called_as_its_shell() -> None:
    slave = _slave()
    with ShellGroup([slave]) as group:
        assert (group.place, group.places) == (slave.place, slave.places)
