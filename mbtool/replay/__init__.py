"""Plays one side of a recording or both, and compares two. No I/O: the shells of slave/ do that."""

from mbtool.replay.bus import BusPlayer, Piece
from mbtool.replay.clock import PlayClock
from mbtool.replay.comparing import Ignored, differences
from mbtool.replay.conductor import Conductor, Manners
from mbtool.replay.judging import Judge, Request, Tolerance
from mbtool.replay.latency import FixedLatency, Latency, RecordedLatency, SampledLatency
from mbtool.replay.matching import Match, OnEnd
from mbtool.replay.player import Device, OnMiss, RecordedSlave
from mbtool.replay.recording import RecordedAnswer, Recording
from mbtool.replay.script import Script, Step
from mbtool.replay.steering import Control, Desk, Progress, Steering
from mbtool.replay.traffic import Traffic
from mbtool.replay.window import Window

__all__ = [
    "BusPlayer",
    "Conductor",
    "Control",
    "Desk",
    "Device",
    "FixedLatency",
    "Ignored",
    "Judge",
    "Latency",
    "Manners",
    "Match",
    "OnEnd",
    "OnMiss",
    "Piece",
    "PlayClock",
    "Progress",
    "RecordedAnswer",
    "RecordedLatency",
    "RecordedSlave",
    "Recording",
    "Request",
    "SampledLatency",
    "Script",
    "Steering",
    "Step",
    "Tolerance",
    "Traffic",
    "Window",
    "differences",
]
