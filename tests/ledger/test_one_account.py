"""Only the account counts requests by poll and by unit.

Looks in the source for what adds to a count with the name of a figure of requests. Rooms below the
ledger are left out: they count to decode, to check rules, or to play.
"""

from __future__ import annotations

import ast
from pathlib import Path
from typing import TYPE_CHECKING

import mbtool

if TYPE_CHECKING:
    from collections.abc import Iterator

SOURCE = Path(mbtool.__file__).parent
ROOMS = (
    "ledger", "troubles", "values", "watching", "views", "workflows", "columns", "cluster", "logs",
    "sources", "api", "cli",
)  # fmt: skip
FIGURES = frozenset(
    (
        "requests", "asked", "answered", "answers", "missing", "unanswered", "retries",
        "repetitions", "late", "exceptions", "refused", "outcomes", "transactions", "malformed",
        "damaged", "no_answer", "unsolicited", "not_captured", "ambiguous",
    )
)  # fmt: skip

ACCOUNT = frozenset(
    (
        ("ledger/account.py", "Account"),
        ("ledger/request_tally.py", "RequestTally"),
        ("ledger/request_order.py", "RequestOrder"),
        ("ledger/observation.py", "Observation"),
        ("ledger/inventory.py", "_master_rows"),  # Adds up tallies.
    )
)
"""The account and its parts."""
READERS = frozenset(
    (
        ("watching/board.py", "slave_rows"),
        ("troubles/polling.py", "short_connections"),
        ("troubles/net_lost.py", "LostConnections"),
        ("values/draft.py", "_observed_functions"),
    )
)
"""These add up counts of the account."""
ALL_TOGETHER = frozenset(
    (
        ("cli/decode.py", "run_job"),
        ("cli/output.py", "RecordOutput"),
        ("cli/tally.py", "Tally"),
        ("columns/table_counts.py", "TransactionCounts"),
        ("columns/table_counts.py", "table_counts"),
        ("views/report/transaction_rows.py", "TransactionRows"),
        ("workflows/ask.py", "PollTally"),
        ("workflows/convert.py", "Conversion"),
        ("workflows/decode_run.py", "_FileTable"),
        ("workflows/extcap.py", "LivePackets"),
        ("workflows/scan.py", "Scan"),
        ("workflows/shared/column_reading.py", "ColumnReading"),
        ("workflows/shared/file_results.py", "FileResults"),
        ("workflows/shared/heartbeat.py", "Counts"),
    )
)
"""These count all transactions that were printed, written, read or asked, and none by poll or
unit."""
STRETCHES = frozenset(
    (
        "troubles/line_damage.py",
        "troubles/line_late.py",
        "troubles/line_sides.py",
        "troubles/line_strays.py",
        "troubles/net_hosts.py",
        "workflows/shared/unreadable_lines.py",
    )
)
"""These modules count signs of an illness in a stretch of time, or of a line or host as one of its
sides hears it. They show none of these counts as a figure of requests."""


def counting_places() -> Iterator[tuple[str, str]]:
    """Yield each module of ROOMS and its class or function that adds to a count of FIGURES."""
    for room in ROOMS:
        for path in sorted((SOURCE / room).rglob("*.py")):
            tree = ast.parse(path.read_text(encoding="utf-8"))
            for top in tree.body:
                if isinstance(top, ast.ClassDef | ast.FunctionDef) and adds(top):
                    yield path.relative_to(SOURCE).as_posix(), top.name


def adds(tree: ast.AST) -> bool:
    return any(
        isinstance(node, ast.AugAssign)
        and isinstance(node.op, ast.Add)
        and not FIGURES.isdisjoint(names_of(node.target))
        for node in ast.walk(tree)
    )


def names_of(target: ast.expr) -> Iterator[str]:
    """Yield the names in a target such as `self._units[key].requests`, without its index."""
    while isinstance(target, ast.Attribute | ast.Subscript):
        if isinstance(target, ast.Attribute):
            yield target.attr.lstrip("_")
        target = target.value
    if isinstance(target, ast.Name):
        yield target.id


def test_only_the_account_counts_requests_by_poll_and_unit() -> None:
    found = set(counting_places())
    others = {(module, name) for module, name in found if module not in STRETCHES}
    assert others == ACCOUNT | READERS | ALL_TOGETHER
    assert {module for module, _ in found} >= STRETCHES


def test_a_count_is_found_whatever_it_is_added_to() -> None:
    for line in (
        "self.units[one.unit].requests += 1", "missing += is_missing", "row.outcomes[x] += n",
        "self._late += 1",
    ):  # fmt: skip
        assert adds(ast.parse(line)), line
    for line in ("requests = 1", "self.rows += 1", "count[requests] += 1", "self.late -= 1"):
        assert not adds(ast.parse(line)), line


def test_only_polls_and_functions_of_units_have_a_tally() -> None:
    makers = {
        path.relative_to(SOURCE).as_posix()
        for room in ROOMS
        for path in (SOURCE / room).rglob("*.py")
        if "RequestTally()" in path.read_text(encoding="utf-8")
    }
    assert makers == {
        "ledger/poll_statistics.py",
        "ledger/unit_account.py",
        "ledger/request_tally.py",
        "watching/board.py",  # Of a unit that was not asked.
    }
