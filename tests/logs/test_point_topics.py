from __future__ import annotations

import json
import re
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from mbtool.devices import PointValue
from mbtool.logs import Rotation, points, read_log
from mbtool.logs.messages import PointMessage
from mbtool.logs.points import PointTopics
from mbtool.logs.rotation import RotatingLog
from mbtool.logs.schemas import json_schema
from mbtool.logs.writer import LogWriter
from tests.logs.samples import stock_messages, transaction

if TYPE_CHECKING:
    from mbtool.devices import NamedTransaction

LAYOUT = Path(__file__).resolve().parents[2] / "docs" / "foxglove-layout.json"


def valued(number: int, value: int, name: str = "CH1 digital value") -> NamedTransaction:
    point = PointValue(name=name, reference="RWr2", value=value, text=str(value))
    return transaction(number, points=[point])


def message(name: str, link: str = "10.0.0.2", unit: int = 0) -> PointMessage:
    return PointMessage(ts_ns=1, link=link, unit_id=unit, name=name, reference="", text="")


def test_a_point_has_a_topic_of_its_own_where_asked(tmp_path: Path) -> None:
    path = tmp_path / "x.mcap"
    items = [valued(1, 5), valued(2, 5), valued(3, 6)]
    with LogWriter(path, capture={}) as log:
        log.give_points_topics()
        for item in items:
            log.write(item)
    told = [(topic, data) for topic, _, data in stock_messages(path) if "/points" in topic]
    shared = [data for topic, data in told if topic == "/points"]
    own = [data for topic, data in told if topic == "/points/rs485/unit_1/CH1_digital_value"]
    assert shared == own
    assert len(told) == 4
    assert list(read_log(path)) == items


def test_each_file_of_a_rotated_log_has_them(tmp_path: Path) -> None:
    with RotatingLog(tmp_path / "x.mcap", Rotation(size=1, time_ns=None), capture={}) as log:
        log.give_points_topics()
        for number in range(2):
            log.write(valued(number, number))
            log.tick(number)
    for part in ("x-0001.mcap", "x-0002.mcap"):
        topics = {topic for topic, _, _ in stock_messages(tmp_path / part)}
        assert "/points/rs485/unit_1/CH1_digital_value" in topics


@pytest.mark.parametrize(
    ("name", "link", "topic"),
    [
        ("CH1 value", "10.0.0.2", "/points/10_0_0_2/unit_0/CH1_value"),
        ("a/b.c", "/dev/ttyUSB0", "/points/_dev_ttyUSB0/unit_0/a_b_c"),
        ("\x1b[31m\u6e29\u5ea6", "fe80::1", "/points/fe80_1/unit_0/_31m_"),
    ],
)
def test_names_need_no_quotes_in_a_message_path(name: str, link: str, topic: str) -> None:
    assert PointTopics().name_of(message(name, link)) == topic
    assert re.fullmatch(r"(/[A-Za-z0-9_-]+)+", topic)


def test_no_two_points_share_a_topic() -> None:
    topics = PointTopics()
    names = [topics.name_of(message(name)) for name in ("a b", "a.b", "a b", "a/b")]
    beginning = "/points/10_0_0_2/unit_0/a_b"
    assert names == [beginning, f"{beginning}_2", beginning, f"{beginning}_3"]


def test_the_number_of_topics_is_bounded(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(points, "MAX_POINT_TOPICS", 2)
    topics = PointTopics()
    names = [topics.name_of(message(name)) for name in ("a", "b", "c", "a")]
    assert names[2] is None
    assert names[3] == names[0]


def test_the_layout_shows_topics_and_fields_of_a_log() -> None:
    layout = json.loads(LAYOUT.read_text())
    panels = layout["configById"]
    paths = [path["value"] for panel in panels.values() for path in panel.get("paths", [])]
    fields = json.loads(json_schema("mbtool.PointValue"))["properties"]
    for path in paths:
        match = re.fullmatch(r"/points\{(\w+)==\$(\w+)\}\.(\w+)", path)
        assert match is not None
        assert {match[1], match[3]} <= set(fields)
        assert match[2] in layout["globalVariables"]
    assert panels["RosOut!mbtool-findings"]["topicToRender"] == "/findings"
    assert panels["RawMessages!mbtool-points"]["topicPath"] == "/points"
    assert set(re.findall(r'"(\w+![\w-]+)"', json.dumps(layout["layout"]))) == set(panels)
