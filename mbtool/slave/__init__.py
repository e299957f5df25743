"""The embedded slave: a device's answers from its profile, and shells that play any responder."""

from mbtool.slave.behaviour import Behaviour, Output
from mbtool.slave.connection_rules import ConnectionRules
from mbtool.slave.driven import DrivenDevice
from mbtool.slave.image import RegisterImage
from mbtool.slave.image_file import Course, FromCapture, Recall, load_image
from mbtool.slave.opening import open_shell, slave_link
from mbtool.slave.responder import DeviceResponder
from mbtool.slave.serial_shell import SerialSlave, open_port, port_in_use
from mbtool.slave.shell import OnExchange, Shell
from mbtool.slave.state_file import keep_state
from mbtool.slave.tcp_shell import Bounds, TcpSlave
from mbtool.slave.units import Units, is_line, units_on

__all__ = [
    "Behaviour",
    "Bounds",
    "ConnectionRules",
    "Course",
    "DeviceResponder",
    "DrivenDevice",
    "FromCapture",
    "OnExchange",
    "Output",
    "Recall",
    "RegisterImage",
    "SerialSlave",
    "Shell",
    "TcpSlave",
    "Units",
    "is_line",
    "keep_state",
    "load_image",
    "open_port",
    "open_shell",
    "port_in_use",
    "slave_link",
    "units_on",
]
