"""Plays one side of a recording. No I/O: the shells of slave/ put it on a link."""

from mbtool.replay.player import OnMiss, RecordedSlave
from mbtool.replay.recording import RecordedAnswer, Recording

__all__ = ["OnMiss", "RecordedAnswer", "RecordedSlave", "Recording"]
