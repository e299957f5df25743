"""Plays one side of a recording, and compares two. No I/O: the shells of slave/ do that."""

from mbtool.replay.clock import PlayClock
from mbtool.replay.comparing import Ignored, differences
from mbtool.replay.conductor import Conductor, Manners
from mbtool.replay.judging import Judge, Request, Tolerance
from mbtool.replay.player import OnMiss, RecordedSlave
from mbtool.replay.recording import RecordedAnswer, Recording
from mbtool.replay.script import Script, Step
from mbtool.replay.traffic import Traffic

__all__ = [
    "Conductor",
    "Ignored",
    "Judge",
    "Manners",
    "OnMiss",
    "PlayClock",
    "RecordedAnswer",
    "RecordedSlave",
    "Recording",
    "Request",
    "Script",
    "Step",
    "Tolerance",
    "Traffic",
    "differences",
]
