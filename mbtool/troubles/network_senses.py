"""The senses that find the troubles of a network."""

from __future__ import annotations

from typing import TYPE_CHECKING

from mbtool.troubles.net_gateway import Gateways
from mbtool.troubles.net_hosts import Hosts
from mbtool.troubles.net_lossy import LossyPaths
from mbtool.troubles.net_lost import LostConnections
from mbtool.troubles.net_polls import NetworkPolls

if TYPE_CHECKING:
    from mbtool.devices.checking.capture_context import CaptureContext
    from mbtool.troubles.sense import Sense


def network_senses(context: CaptureContext) -> list[Sense]:
    """Return a sense of each kind; `context` has facts about the present capture."""
    del context
    return [NetworkPolls(), Gateways(), LostConnections(), LossyPaths(), Hosts()]
