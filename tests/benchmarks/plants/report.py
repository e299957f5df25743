"""The table of plants: python -m tests.benchmarks.line --plants [--help]."""

# Each row is a plant and an adapter, the worst first:
#
#   found      transactions told rightly, or told as ambiguous where nobody can know
#   sure wrong transactions told with a confidence of 0.9 or more that are not in the truth
#   0.9+       frames told with 0.9 or more whose direction is wrong, or that are none; 0.8+ is the
#              same of those told with 0.8 to 0.9
#   pairs 0.9+ pairs told with 0.9 or more that are none
#   ambiguous  transactions told as ambiguous though the truth can be known
#   times cost by how many points fewer transactions are right than without times (more than
#              TIMES_MAY_COST breaks the rule that times never make it worse)
#   command    how many transactions `mbtool decode` tells otherwise than the class
#
# As Markdown it is shorter: a row for each plant, with found and sure wrong in a column for each
# adapter; of a decoder that tells no transactions, the frames found.

from __future__ import annotations

import json
import sys
from math import ceil, floor
from typing import TYPE_CHECKING

from rich.console import Console
from rich.table import Table

from tests.benchmarks.plants.catalog import PLANTS
from tests.benchmarks.plants.decoding import hear
from tests.benchmarks.plants.delivery import Adapter
from tests.benchmarks.plants.measuring import (
    PlantCell,
    compare_command,
    find_example,
    measure_plant,
    seeds_from_commit,
)

if TYPE_CHECKING:
    import argparse
    from collections.abc import Iterator, Sequence

    from tests.benchmarks.plants.examples import Decode

TIMES_MAY_COST = 0.0002
HEADINGS = (
    "plant", "adapter", "decoder", "found", "sure wrong", "frames", "false", "0.9+", "0.8+",
    "pairs 0.9+", "ambiguous", "transactions", "doubtful", "hidden", "times cost", "command",
)  # fmt: skip
WORDS = 3
"""How many of the columns are words, not numbers."""


def add_options(parser: argparse.ArgumentParser) -> None:
    options = parser.add_argument_group(
        "plants", "lines with exact truth, made by tests/benchmarks/plants; --cell is PLANT/ADAPTER"
    )
    options.add_argument("--plants", action="store_true", help="measure plants in place of damage")
    options.add_argument("--seeds", type=int, nargs="+", metavar="N", help="default: --seed")
    options.add_argument(
        "--seeds-from-commit", type=int, metavar="N", help="N seeds drawn from the commit's hash"
    )
    options.add_argument("--markdown", action="store_true", help="the table as Markdown")
    options.add_argument(
        "--examples", action="store_true", help="a short recording for each cell with a mistake"
    )
    options.add_argument(
        "--command", action="store_true", help="compare `mbtool decode` with the class"
    )


def main(asked: argparse.Namespace, decoders: dict[str, Decode]) -> None:
    """Measure and print what the options ask for."""
    seeds = chosen_seeds(asked)
    wanted = list(chosen(asked.cell))
    done = []
    for plant, adapter in wanted:
        for name, decode in decoders.items():
            cell = PlantCell(plant, adapter, name)
            measure_plant(cell, seeds, asked.transactions, decode)
            if decode is hear and asked.command:
                compare_command(cell, seeds, asked.transactions)
            if asked.examples:
                find_example(cell, seeds, asked.transactions, decode)
            done.append(cell)
            if asked.json:
                sys.stdout.write(json.dumps(as_json(cell)) + "\n")
    if not asked.json:
        print_table(done, seeds, asked)


def chosen_seeds(asked: argparse.Namespace) -> list[int]:
    if asked.seeds_from_commit:
        return seeds_from_commit(asked.seeds_from_commit)
    return asked.seeds or [asked.seed]


def chosen(cell: str | None) -> Iterator[tuple[str, Adapter]]:
    """The plants and adapters whose names contain what was asked for: 'write/FTDI'."""
    plant, _, adapter = (cell or "").partition("/")
    for name in PLANTS:
        for each in Adapter:
            if plant in name and adapter in each:
                yield name, each


def as_json(cell: PlantCell) -> dict[str, object]:
    head: dict[str, object] = {
        "plant": cell.plant,
        "adapter": cell.adapter,
        "decoder": cell.decoder,
    }
    if cell.differences is not None:
        head["command_differs"] = cell.differences
    return head | cell.figures.as_json()


def print_table(
    cells: Sequence[PlantCell], seeds: Sequence[int], asked: argparse.Namespace
) -> None:
    if asked.markdown:
        sys.stdout.write(markdown(cells))
    else:
        table = Table(box=None, pad_edge=False)
        for place, heading in enumerate(HEADINGS):
            table.add_column(heading, justify="left" if place < WORDS else "right", no_wrap=True)
        for cell in sorted(cells, key=_worst_first):
            table.add_row(*row(cell, times_cost(cell, cells)))
        Console(width=180).print(table)
    sys.stdout.write(f"seeds {' '.join(map(str, seeds))}\n")
    for cell in cells:
        told = [*cell.figures.misses[: asked.misses], *(cell.differences or ())[: asked.misses]]
        told += [cell.example] if cell.example else []
        if told:
            sys.stdout.write(f"\n{cell.plant}, {cell.adapter}, {cell.decoder}\n")
            sys.stdout.write("".join(f"{one}\n" for one in told))


def _worst_first(cell: PlantCell) -> tuple[float, float]:
    figures = cell.figures
    share = figures.found_share if figures.found_share is not None else figures.frames_found_share
    return share or 0.0, -(figures.sure_wrong_share or 0.0)


def markdown(cells: Sequence[PlantCell]) -> str:
    adapters = list(dict.fromkeys(cell.adapter for cell in cells))
    rows: dict[tuple[str, ...], dict[Adapter, PlantCell]] = {}
    several = len({cell.decoder for cell in cells}) > 1
    for cell in sorted(cells, key=_worst_first):
        head = (cell.plant, cell.decoder) if several else (cell.plant,)
        rows.setdefault(head, {})[cell.adapter] = cell
    headings = ["plant", *(["decoder"] if several else ()), *adapters]
    lines = [
        headings,
        ["---"] * len(headings),
        *([*head, *(brief(row[adapter]) for adapter in adapters)] for head, row in rows.items()),
    ]
    return "".join(f"| {' | '.join(line)} |\n" for line in lines)


def brief(cell: PlantCell) -> str:
    """What a decoder finds, and what it tells wrongly and is sure of, in percent."""
    one = cell.figures
    if one.found_share is None:
        return percent(one.frames_found_share).rstrip(" %")
    shares = percent(one.found_share), percent(one.sure_wrong_share, up=True)
    return " / ".join(share.rstrip(" %") for share in shares)


def times_cost(cell: PlantCell, cells: Sequence[PlantCell]) -> float | None:
    """How much smaller the share told rightly is than without times; None if that is unknown."""
    same = (cell.plant, cell.decoder)
    for one in cells:
        if one.adapter is Adapter.NO_TIMES and (one.plant, one.decoder) == same:
            without, with_times = one.figures.right_share, cell.figures.right_share
            if without is not None and with_times is not None and one is not cell:
                return without - with_times
    return None


def row(cell: PlantCell, cost: float | None) -> list[str]:
    one = cell.figures
    return [
        cell.plant,
        cell.adapter,
        cell.decoder,
        percent(one.found_share),
        percent(one.sure_wrong_share, up=True),
        percent(one.frames_found_share),
        str(one.frames_false),
        percent(one.sure_amiss_share, up=True),
        percent(one.likely_amiss_share, up=True),
        percent(one.pairs_amiss_share, up=True),
        percent(one.ambiguous_knowable_share, up=True),
        str(one.transactions),
        str(one.doubtful),
        str(one.hidden),
        f"{100 * cost:.2f}" if cost is not None and cost > TIMES_MAY_COST else "-",
        "-" if cell.differences is None else str(len(cell.differences)),
    ]


def percent(share: float | None, *, up: bool = False) -> str:
    """Rounded away from what is good: 100 % means all, and 0 % none."""
    if share is None:
        return "-"
    hundredths = ceil(share * 10_000 - 1e-6) if up else floor(share * 10_000 + 1e-6)
    return f"{hundredths / 100:.2f} %"
