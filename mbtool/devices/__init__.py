"""Device profiles, and transactions with the names that profiles give to registers and bits.

A profile holds as data what a vendor's manual says about a device.
"""

from mbtool.devices.assignment import Assignment, Assignments, Who, parse_assignment, parse_who
from mbtool.devices.difference import Difference, DifferenceKind, Side
from mbtool.devices.dumping import dump_profile
from mbtool.devices.loading import (
    builtin_profiles,
    load_profile,
    profile_from_json,
    profile_to_json,
)
from mbtool.devices.model import Access, Area, Exceptions, FunctionRule, Point, Profile, Timing
from mbtool.devices.named_transaction import NamedTransaction, PointValue
from mbtool.devices.naming import Namer
from mbtool.devices.point_types import ByteOrder, PointType, WordOrder
from mbtool.devices.profile_checks import finding_text
from mbtool.devices.references import parse_reference, write_reference
from mbtool.devices.schema import profile_schema
from mbtool.devices.spans import Span, find_span, parse_span
from mbtool.devices.values import PointInstance, registers_of
from mbtool.devices.wording import describe, describe_points, describe_written, subject_of

__all__ = [
    "Access",
    "Area",
    "Assignment",
    "Assignments",
    "ByteOrder",
    "Difference",
    "DifferenceKind",
    "Exceptions",
    "FunctionRule",
    "NamedTransaction",
    "Namer",
    "Point",
    "PointInstance",
    "PointType",
    "PointValue",
    "Profile",
    "Side",
    "Span",
    "Timing",
    "Who",
    "WordOrder",
    "builtin_profiles",
    "describe",
    "describe_points",
    "describe_written",
    "dump_profile",
    "find_span",
    "finding_text",
    "load_profile",
    "parse_assignment",
    "parse_reference",
    "parse_span",
    "parse_who",
    "profile_from_json",
    "profile_schema",
    "profile_to_json",
    "registers_of",
    "subject_of",
    "write_reference",
]
