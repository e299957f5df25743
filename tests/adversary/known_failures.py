"""What the decoder still gets wrong of the simulated plants, by master and losses.

The tests expect exactly these cells to fail: one that passes must leave the list.
"""

from __future__ import annotations

WRONG: dict[str, set[str]] = {
    "constant 0": {"request lost + late", "silent + retransmitted"},
    "constant 3": {"request lost + late", "late + doubled"},
    "pipelined constant": {"several lost + retransmitted"},
    "connections": {"late + retransmitted"},
}
"""Cells in which a response is joined with a request that it does not answer."""

BLAMED: dict[str, set[str]] = {
    "constant 0": {"request lost + late", "silent + retransmitted"},
    "pipelined constant": {"several lost + retransmitted"},
    "pipelined counting": {"several lost + silent"},
    "connections": {"request lost + silent", "several lost + silent"},
}
"""Cells in which a slave is blamed for what the capture lacks."""
