"""The senses that find the troubles of a network."""

from __future__ import annotations

from typing import TYPE_CHECKING

from mbtool.troubles.net_gateway import Gateways
from mbtool.troubles.net_hosts import Hosts
from mbtool.troubles.net_lost import LossyPaths, LostConnections
from mbtool.troubles.net_polls import NetworkPolls

if TYPE_CHECKING:
    from mbtool.troubles.cases import Cases
    from mbtool.troubles.sense import Sense


def network_senses(cases: Cases) -> list[Sense]:
    """Return a sense of each kind; `cases` has the slow answers as evidence."""
    return [NetworkPolls(cases), Gateways(), LostConnections(), LossyPaths(), Hosts()]
