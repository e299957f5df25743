"""The decoders that read plants: this project's, and the peers that are installed."""

from __future__ import annotations

from typing import TYPE_CHECKING

from tests.benchmarks.adapters import Column, Wire
from tests.benchmarks.line_peers import installed
from tests.benchmarks.plants.decoding import hear
from tests.benchmarks.plants.delivery import Adapter, delivered
from tests.benchmarks.plants.judging import Told, ToldFrame, ToldTransaction

if TYPE_CHECKING:
    from tests.benchmarks.figures import Heard
    from tests.benchmarks.line_peers import Peer
    from tests.benchmarks.plants.examples import Decode
    from tests.benchmarks.plants.recording import Recording

OF_PLANTS = ("tshark", "pymodbus searched")
"""The peers that are tried; what others find is no better (docs/rs485.md)."""


def plant_decoders(*, peers: bool) -> dict[str, Decode]:
    decoders: dict[str, Decode] = {"mbtool": hear}
    if peers:
        here, _ = installed()
        decoders |= {name: as_decode(peer) for name, peer in here.items() if name in OF_PLANTS}
    return decoders


def as_decode(peer: Peer) -> Decode:
    def decode(recording: Recording, adapter: Adapter) -> Told:
        wire = Wire(recording.line, recording.data, recording.times)
        column = Column.NO_TIMES if adapter is Adapter.NO_TIMES else Column.BYTES
        return as_told(peer(wire, delivered(recording, adapter), column))

    return decode


def as_told(heard: Heard) -> Told:
    """What a peer says; it says nothing of confidence, so where it is not sure it has none."""
    frames = [
        ToldFrame(offset, raw, direction, 0.0 if direction is None else 1.0)
        for offset, raw, direction in heard.frames
    ]
    if heard.transactions is None:
        return Told(frames, None)
    raws = {one.offset: one.raw for one in frames}

    def frame(offset: int | None) -> tuple[int, bytes] | None:
        return None if offset is None else (offset, raws[offset])

    transactions = [
        ToldTransaction(frame(request), frame(response), outcome, 1.0, is_ambiguous=False)
        for request, response, outcome in heard.transactions
    ]
    return Told(frames, transactions)
