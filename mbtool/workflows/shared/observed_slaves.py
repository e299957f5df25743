"""Collects the slaves in a recording, with a summary of the requests and responses of each."""

# Memory: an ObservedSlave (devices/observed_slave.py) for each of at most MAX_SLAVES slaves; the
# transactions of further slaves are only counted. Register values are kept only on request.

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING

from mbtool.core import UsageError, WireEvent
from mbtool.devices.observed_slave import ObservedSlave, OnRow

if TYPE_CHECKING:
    from mbtool.decode.decoder import Record
    from mbtool.devices import NamedTransaction, Who

MAX_SLAVES = 2048
_SHOWN = 12
"""An error message names at most this many slaves."""


class ObservedSlaves:
    """The slaves of a recording, in the order in which they first appear."""

    def __init__(
        self, who: Who | None = None, *, with_values: bool = False, on_row: OnRow | None = None
    ) -> None:
        """Collect all slaves; with `who`, only those with the address and unit that `who` names.

        With `with_values`, the values of their registers are kept, too. `on_row` gets all of them.
        """
        self._who = who
        self._on_row = on_row
        self._with_values = with_values
        self._slaves: dict[tuple[str, str | None, int], ObservedSlave] = {}
        self.forgotten = 0
        """The number of transactions that were left out because their slaves were beyond
        MAX_SLAVES."""

    def add(self, records: Iterable[Record]) -> None:
        for record in records:
            if not isinstance(record, WireEvent):
                self._note(record)

    def _note(self, transaction: NamedTransaction) -> None:
        destination, unit = transaction.destination, transaction.unit
        if self._who is not None and not self._who.fits_slave(destination, unit):
            return
        # The key of a slave on a network has no link, as several interfaces may have captured the
        # slave.
        key = (transaction.link if destination is None else "", destination, unit)
        seen = self._slaves.get(key)
        if seen is None:
            if len(self._slaves) >= MAX_SLAVES:
                self.forgotten += 1
                return
            seen = self._slaves[key] = ObservedSlave(
                *key, with_values=self._with_values, on_row=self._on_row
            )
        seen.note(transaction)

    @property
    def slaves(self) -> list[ObservedSlave]:
        return list(self._slaves.values())

    def only(self, option: str) -> ObservedSlave:
        """Return the slave if there is only one, or if only one of several has sent responses.

        Otherwise raises UsageError. Its message names `option`, the command's option that chooses a
        slave.
        """
        slaves = self.slaves
        if len(slaves) == 1:
            return slaves[0]
        answering = [one for one in slaves if one.has_responded]
        if len(answering) == 1:
            return answering[0]
        raise UsageError(_which(slaves, answering or slaves, option))


def _which(slaves: Sequence[ObservedSlave], choices: Sequence[ObservedSlave], option: str) -> str:
    if not slaves:
        return f"no transaction of such a slave is there; {option} chooses another"
    plain = Counter(one.who.at_any_port for one in choices)
    names = [
        f"{one.who} on {one.link}"
        if one.destination is None
        else str(one.who if plain[one.who.at_any_port] > 1 else one.who.at_any_port)
        for one in choices
    ]
    shown = ", ".join(names[:_SHOWN])
    more = f" and {len(names) - _SHOWN} more" if len(names) > _SHOWN else ""
    return f"{len(choices)} slaves are there: {shown}{more}; name one with {option}"
