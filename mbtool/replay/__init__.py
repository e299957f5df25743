"""Plays a recording back as the slave, the master or the whole line; compares recordings.

No I/O.
"""

from mbtool.replay.bus import BusPlayer, ByteRun
from mbtool.replay.clock import PlayClock
from mbtool.replay.comparing import Ignored, differences
from mbtool.replay.conductor import Conductor
from mbtool.replay.connection_player import ConnectionPlayer
from mbtool.replay.judging import RequestReport, ResponseJudge, Tolerance
from mbtool.replay.latency import FixedLatency, LatencyModel, RecordedLatency, SampledLatency
from mbtool.replay.matching import MatchStrategy, OnEnd
from mbtool.replay.player import AnsweredFrom, Device, OnMiss, RecordedSlave
from mbtool.replay.recording import RecordedAnswer, Recording, RequestKind
from mbtool.replay.script import Script, Step
from mbtool.replay.steering import Control, PlayerControls, Progress, Steering
from mbtool.replay.timeline import TimeRange
from mbtool.replay.traffic import Traffic

__all__ = [
    "AnsweredFrom",
    "BusPlayer",
    "ByteRun",
    "Conductor",
    "ConnectionPlayer",
    "Control",
    "Device",
    "FixedLatency",
    "Ignored",
    "LatencyModel",
    "MatchStrategy",
    "OnEnd",
    "OnMiss",
    "PlayClock",
    "PlayerControls",
    "Progress",
    "RecordedAnswer",
    "RecordedLatency",
    "RecordedSlave",
    "Recording",
    "RequestKind",
    "RequestReport",
    "ResponseJudge",
    "SampledLatency",
    "Script",
    "Steering",
    "Step",
    "TimeRange",
    "Tolerance",
    "Traffic",
    "differences",
]
