"""Small windows in which the user chooses columns, or the column to sort by."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rich.text import Text
from textual.binding import Binding
from textual.containers import Vertical
from textual.screen import ModalScreen
from textual.widgets import OptionList, Static
from textual.widgets.option_list import Option

if TYPE_CHECKING:
    from collections.abc import Collection, Mapping, Sequence

    from textual.app import ComposeResult

    from mbtool.views.watch_columns import WatchColumn

AS_IT_COMES = ""
"""The result of SortChoice for no sorting: rows stay in the order in which they come."""
_CSS = """
%s { align: center middle; }
%s > Vertical { width: 56; height: auto; max-height: 90%%; border: solid $accent; padding: 0 1; }
%s OptionList { height: auto; max-height: 16; border: none; padding: 0; }
"""


class ColumnChoice(ModalScreen[list[str] | None]):
    """A window whose result is the names of the columns that the user wants.

    An empty list stands for the usual columns, and None for no change.
    """

    CSS = _CSS % (("ColumnChoice",) * 3)
    BINDINGS = [  # noqa: RUF012 - textual reads the list from the class
        Binding("escape", "dismiss(None)", "Leave"),
        Binding("enter", "take", "Take", priority=True),
        Binding("space", "turn", "On or off", priority=True),
        Binding("u", "usual", "The usual columns"),
    ]

    def __init__(
        self,
        columns: Sequence[WatchColumn],
        wanted: Collection[str],
        left_out: Mapping[str, str] | None = None,
    ) -> None:
        """`wanted` are the names of columns that are on; `left_out` says by name why some of them
        are not seen all the same.
        """
        super().__init__()
        self._columns, self._wanted = columns, set(wanted)
        self._before, self._left_out = frozenset(wanted), left_out or {}

    def compose(self) -> ComposeResult:
        with Vertical():
            yield Static("space turns one on or off, enter takes, u: the usual", markup=False)
            yield OptionList(*(Option(self._line(one), one.name) for one in self._columns))

    def _line(self, column: WatchColumn) -> Text:
        # The sign shows the state without colour, too.
        line = Text(f"{'[x]' if column.name in self._wanted else '[ ]'} {column.name}")
        why = self._left_out.get(column.name) if column.name in self._before else None
        return line if why is None else line.append(f"  {why}", "dim")

    def action_turn(self) -> None:
        options = self.query_one(OptionList)
        at = options.highlighted
        if at is not None:
            self._wanted ^= {self._columns[at].name}
            options.replace_option_prompt_at_index(at, self._line(self._columns[at]))

    def action_take(self) -> None:
        names = [one.name for one in self._columns if one.name in self._wanted]
        self.dismiss(None if self._wanted == self._before else names)

    def action_usual(self) -> None:
        self.dismiss([])


class SortChoice(ModalScreen[str | None]):
    """A window whose result is the name of the column to sort by; AS_IT_COMES for no sorting."""

    CSS = _CSS % (("SortChoice",) * 3)
    BINDINGS = [Binding("escape", "dismiss(None)", "Leave")]  # noqa: RUF012 - see above

    def __init__(self, columns: Sequence[WatchColumn], sorted_by: str | None) -> None:
        super().__init__()
        self._columns, self._sorted_by = columns, sorted_by

    def compose(self) -> ComposeResult:
        with Vertical():
            yield Static("sort by; the same again turns the order", markup=False)
            options = [Option("as it comes", "-")]
            options += [Option(one.name, one.name) for one in self._columns]
            yield OptionList(*options)

    def on_mount(self) -> None:
        choice = self.query_one(OptionList)
        names = [AS_IT_COMES, *(one.name for one in self._columns)]
        # The settings may name a column that this version does not have.
        choice.highlighted = names.index(self._sorted_by) if self._sorted_by in names else 0

    def on_option_list_option_selected(self, event: OptionList.OptionSelected) -> None:
        name = event.option.id
        self.dismiss(AS_IT_COMES if name in (None, "-") else name)
