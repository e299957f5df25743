"""A simulated slave as its profile describes it: register image, responses, changing values.

No I/O.
"""

from mbtool.slave.device.behaviour import Behaviour, DeviceOutput
from mbtool.slave.device.connection_policy import ConnectionPolicy
from mbtool.slave.device.driven import DrivenDevice
from mbtool.slave.device.image import RegisterImage
from mbtool.slave.device.image_file import Course, FromCapture, Recall, load_image
from mbtool.slave.device.responder import DeviceResponder, Units, is_line, units_on

__all__ = [
    "Behaviour",
    "ConnectionPolicy",
    "Course",
    "DeviceOutput",
    "DeviceResponder",
    "DrivenDevice",
    "FromCapture",
    "Recall",
    "RegisterImage",
    "Units",
    "is_line",
    "load_image",
    "units_on",
]
