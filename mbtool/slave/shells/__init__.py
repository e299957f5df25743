"""Shells: each connects a responder, which has no I/O, to a TCP endpoint or a serial line."""

from mbtool.slave.shells.opening import open_shell, slave_link
from mbtool.slave.shells.serial_shell import SerialSlave
from mbtool.slave.shells.shell import OnExchange, Shell
from mbtool.slave.shells.state_file import keep_state
from mbtool.slave.shells.tcp_shell import Bounds, TcpSlave
from mbtool.slave.shells.udp_shell import UdpSlave

__all__ = [
    "Bounds",
    "OnExchange",
    "SerialSlave",
    "Shell",
    "TcpSlave",
    "UdpSlave",
    "keep_state",
    "open_shell",
    "slave_link",
]
