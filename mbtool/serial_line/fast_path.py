"""What can be told at once of the bytes at the front of an RTU line, without a search."""

# Most bytes of a working line are decided here. A frame is beyond doubt where its length follows
# from its function, its CRC is right in one reading only (or the other is out of the question),
# and the turn expects it. It needs the byte behind it, or silence. And bytes are surely the mere
# beginning of a frame where it is due and longer: then there is nothing to search before more come.

from __future__ import annotations

from typing import TYPE_CHECKING

from mbtool.core import Direction
from mbtool.framing.rtu_lengths import MIN_FRAME, frame_size
from mbtool.modbus.adu import MAX_RTU_ADU, DirectionBy
from mbtool.modbus.adu_bytes import crc
from mbtool.modbus.functions import EXCEPTION_BIT
from mbtool.serial_line import costs
from mbtool.serial_line.bus_model import ROLES, SURE, BusModel, Classification

if TYPE_CHECKING:
    from collections.abc import Sequence

_ALMOST_CERTAIN = 0.98
_NEARLY_CERTAIN = 0.95
_REQUEST_ALONE = [Direction.REQUEST]
_OUT_OF_THE_QUESTION = 10.0
"""By how many bits a frame is dearer that need not be looked at beside another."""
_LIKELY = costs.REQUEST + costs.NEW_REQUEST
"""What a frame may cost to be taken without a search."""


class FastPath:
    """Looks at the bytes held, from the first on, until it is told that they have gone."""

    def __init__(self, turns: BusModel, speaker: Direction | None, most: int) -> None:
        """`most` bytes are looked at by a search, whatever they are."""
        self.awaited = MIN_FRAME
        """How many bytes there have to be before more can be told."""
        self._turns = turns
        self._speaker = speaker
        self._most = most
        self._is_behind_noise = False
        self._roles = ROLES if speaker is None else (speaker,)
        self._sizes: list[tuple[Direction, int]] = []
        """How long the front is as a frame of each role, once its bytes say so."""

    def begin(self, *, behind_noise: bool) -> None:
        """Other bytes are at the front now; those before them may have been no frame."""
        self._is_behind_noise = behind_noise
        self.awaited = MIN_FRAME
        self._sizes = []

    def frame(
        self, data: bytes, start_ns: int, burst_over: bool
    ) -> tuple[int, Classification] | None:
        """The size of the frame at the front and what it is, if that is beyond doubt.

        `start_ns` is when its first byte began. `burst_over` says that a silence follows all bytes.
        """
        sizes = self._sizes or self._measure(data)
        have = len(data)
        if not sizes or (have < self.awaited and not burst_over):
            return None
        head = data[:MAX_RTU_ADU]
        found = 0
        roles: list[Direction] = []
        for role, size in sizes:
            if size <= have and crc(head[:size]) == 0:
                if found not in (0, size):
                    found, roles = self._likelier(head, start_ns, (found, roles[0]), (size, role))
                    break
                found = size
                roles.append(role)
        if not found:
            return None
        if self._speaker is not None:
            return found, Classification(self._speaker, DirectionBy.PORT, 1.0)
        turns = self._turns
        unit, pdu = head[0], head[1 : found - 2]
        judgement = turns.judge(unit, pdu, start_ns, roles)
        if turns.weigh(turns.turn, unit, pdu, judgement.direction, start_ns) > _LIKELY and (
            roles != _REQUEST_ALONE or not self._is_usual(unit, pdu)
        ):
            return None
        if len(roles) > 1 and not self._is_told(judgement, head, found):
            return None
        return found, judgement

    def is_begun(self, data: bytes, torn_at: Sequence[int]) -> bool:
        """Whether all bytes are the beginning of a frame that is due. `torn_at`: its silences."""
        if self._speaker is not None:
            return False
        sizes = self._sizes or (self._measure(data) if len(data) >= MIN_FRAME else [])
        if not self._turns.awaits(data, dict(sizes)):
            return False
        if any(size <= len(data) and crc(data[:size]) == 0 for _, size in sizes):
            return False
        return not any(self._is_frame(data[place:]) for place in torn_at)

    def _is_frame(self, data: bytes) -> bool:
        """Whether a whole frame of known form begins here."""
        sizes = [frame_size(data, role) or self._most for role in self._roles]
        return any(size <= len(data) and crc(data[:size]) == 0 for size in sizes)

    def _measure(self, data: bytes) -> list[tuple[Direction, int]]:
        """How long the front is as a frame of each role; empty where one has no known length."""
        head = data[:MAX_RTU_ADU]
        sizes, longest = [], 0
        for role in self._roles:
            size = frame_size(head, role)
            if size == 0 and role is Direction.REQUEST and head[1] & EXCEPTION_BIT:
                continue  # An exception, and no request of a function that nobody has.
            if not size:
                self.awaited = len(head) + 1 if size is None else self._most
                return []
            if size <= MAX_RTU_ADU:
                sizes.append((role, size))
                longest = size if size > longest else longest
        self.awaited = longest + 1 if sizes else self._most
        self._sizes = sizes
        return sizes

    def _likelier(
        self, head: bytes, start_ns: int, *frames: tuple[int, Direction]
    ) -> tuple[int, list[Direction]]:
        """The longer of two frames that begin alike, if the other is out of the question; or 0.

        Each frame that ends in 00 has a correct CRC without it, too.
        """
        turns = self._turns
        shorter, longer = (
            turns.weigh(turns.turn, head[0], head[1 : size - 2], role, start_ns)
            for size, role in sorted(frames)
        )
        size, role = max(frames)
        is_told = len(turns.likely) == 1 and longer + _OUT_OF_THE_QUESTION <= shorter
        return (size, [role]) if is_told else (0, [])

    def _is_usual(self, unit: int, pdu: bytes) -> bool:
        """Whether a frame is a request of this line and cannot begin the response that is due."""
        is_due = any(
            turn.waiting is not None and turn.waiting.is_named_by(unit, pdu[0])
            for _, turn in self._turns.likely
        )
        return self._turns.was_asked(unit, pdu) and not is_due and not self._is_behind_noise

    def _is_told(self, judgement: Classification, head: bytes, size: int) -> bool:
        """Whether the direction of a frame that has the form of both is beyond doubt."""
        if self._turns.trusts_silences:
            return judgement.confidence >= SURE
        if judgement.direction is Direction.REQUEST:
            return judgement.confidence >= _ALMOST_CERTAIN
        # Without silences the same frame twice may be a request and its echo, or one that was
        # repeated. What comes behind them tells, if it is of the same unit and function, and how
        # long the line was silent in all.
        return (
            judgement.confidence >= _NEARLY_CERTAIN
            and not head.startswith(head[size : size + 2])
            and not self._turns.pause_cost(self._turns.turn)
        )
