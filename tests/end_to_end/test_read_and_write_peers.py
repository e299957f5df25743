"""mbtool read, write and poll against a slave of others."""

from __future__ import annotations

import json

from tests.end_to_end.peers import SIZE, UNIT, pymodbus_server
from tests.end_to_end.programs import mbtool, run_mbtool


def test_reads_and_writes_what_a_pymodbus_server_has() -> None:
    with pymodbus_server() as (port, _):
        link, unit = f"tcp:127.0.0.1:{port}", ("--unit", str(UNIT), "--format", "jsonl")
        everything = (f"holding 0..{SIZE - 1}", f"coil 0..{SIZE - 1}", "di 5..9", "ir 3")
        rows = [
            json.loads(line) for line in run_mbtool("read", link, *everything, *unit).splitlines()
        ]
        run_mbtool(
            "write",
            link,
            "holding 20=4660",
            "holding 21=1,22136,65535",
            "coil 8=1,0,1,1",
            "--yes",
            *unit,
        )
        written = run_mbtool("read", link, "holding 20..23", "coil 8..11", *unit).splitlines()
        with mbtool("read", link, "holding 60000", *unit) as program:
            assert program.wait() == 1
            refused = json.loads(program.printed.text)
    words = rows[0]["response_values"] + rows[1]["response_values"]
    assert words == [10 * place for place in range(SIZE)]
    assert rows[2]["response_values"] == [int(place % 5 == 0) for place in range(SIZE)]
    assert rows[3]["response_values"] == [1, 0, 0, 0, 0]
    assert rows[4]["response_values"] == [30]
    assert [json.loads(line)["response_values"] for line in written] == [
        [4660, 1, 22136, 65535],
        [1, 0, 1, 1],
    ]
    assert refused["exception_name"] == "illegal data address"
