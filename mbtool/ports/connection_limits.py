"""Limits for a listener: masters connected at once, new connections per second, idle time."""

# A connection that comes faster than the rate allows is reset. The rate is a bucket of tokens: a
# burst of as many connections as may come in one second is accepted at once, then one for each
# token that the passing time adds.

from __future__ import annotations

import math
from dataclasses import dataclass

DEFAULT_PER_SECOND = 100.0
SPARE_S = 1.0
"""If a tap has as many connections as its limit allows, a new one replaces an unused one. Unused is
a connection on which the slave has never answered, or that one side has ended, and that carried no
byte for this many seconds. (The TCP guide, V1.0b, 4.3.2, also closes the oldest unused one.)"""


@dataclass(frozen=True, slots=True, kw_only=True)
class ConnectionLimits:
    """The limits for connections to one endpoint that the user has set; None means the default."""

    connections: int | None = None
    per_second: float | None = None
    """The most new connections in a second; None means DEFAULT_PER_SECOND."""
    idle_s: float | None = None


class ConnectionRate:
    """Limits the rate of new connections with a bucket of tokens."""

    def __init__(self, per_second: float | None) -> None:
        self.per_second = DEFAULT_PER_SECOND if per_second is None else per_second
        self._left = self._burst = max(self.per_second, 1.0)
        self._at_s = -math.inf

    def admits(self, now_s: float) -> bool:
        """Count a new connection at `now_s` (seconds); return True if the rate allows it."""
        self._left = min(self._burst, self._left + max(now_s - self._at_s, 0.0) * self.per_second)
        self._at_s = now_s
        if self._left < 1.0:
            return False
        self._left -= 1.0
        return True
