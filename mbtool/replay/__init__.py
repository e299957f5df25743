"""Plays one side of a recording, and compares two. No I/O: the shells of slave/ do that."""

from mbtool.replay.comparing import Ignored, differences
from mbtool.replay.player import OnMiss, RecordedSlave
from mbtool.replay.recording import RecordedAnswer, Recording
from mbtool.replay.traffic import Traffic

__all__ = [
    "Ignored",
    "OnMiss",
    "RecordedAnswer",
    "RecordedSlave",
    "Recording",
    "Traffic",
    "differences",
]
