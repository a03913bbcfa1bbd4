"""The last order with each vehicle's answer as it comes in; who failed says why, and what can be done."""

from __future__ import annotations

from rich.cells import cell_len
from rich.segment import Segment
from textual.strip import Strip
from textual.widget import Widget

from groundstation.console import theme
from groundstation.console.theme import FAINT, TEXT, WARN, clean
from groundstation.orders.result import OrderResult, VehicleResult

_MOST_FAILED = 3
_ADVICE = {
    "no answer": "Is its agent running? ctrl+l lands everybody, past silent agents too.",
    "failed": "Look at it; hold (F6) or land (F7) it, or give the order again.",
    "timed out": "It is still where it stopped: hold (F6) or land (F7) it, or give the order again.",
    "unfinished": "Watch it; hold (F6) or land (F7) it.",
    "refused": "Nothing was changed. Correct this, and give the order again.",
    "direct": "Watch it come down; RC switch ready.",
}


def advice(result: VehicleResult) -> str:
    """What the operator can do about a result; empty where there is nothing to do."""
    return _ADVICE.get(result.phase, "")


class ResultLine(Widget):
    """One line for the order, and up to three for vehicles that did not do it."""

    def __init__(self, name: str) -> None:
        super().__init__(id=name, classes="empty")
        self._rows: list[list[Segment]] = []

    def show_order(self, handle: OrderResult, text: str) -> None:
        """Results as they stand, after the order's own words."""
        words = clean(text, 60)
        first = [Segment(f" {theme.fit(words, min(34, cell_len(words)))} ", theme.style(TEXT, bold=True))]
        # Many vehicles: the good ends are counted, so that those that need an eye stay in sight.
        counts: dict[str, int] = {}
        for result in handle.results.values():
            counts[result.phase] = counts.get(result.phase, 0) + 1
        room = (self.size.width or 80) - first[0].cell_length
        if sum(cell_len(name) + cell_len(one.phase) + 5 for name, one in handle.results.items()) <= room:
            parts = [(f"  {name} {{}} {one.phase}", str(one.phase)) for name, one in handle.results.items()]
        else:
            parts = [(f"  {{}} {count} {phase}", phase) for phase, count in counts.items()]
        for words, phase in parts:
            sign, colour = theme.PHASE_SIGNS.get(phase, ("?", WARN))
            first.append(Segment(words.format(sign), theme.style(colour)))
        rows = [first]
        failed = [one for one in handle.results.values() if advice(one)]
        hidden = len(failed) - _MOST_FAILED
        for place, one in enumerate(failed[:_MOST_FAILED]):
            sign, colour = theme.PHASE_SIGNS.get(one.phase, ("?", WARN))
            why = clean(one.sentence, 200) or one.phase
            name = "" if why.startswith(one.vehicle) else f"{one.vehicle}: "
            more = f" (+{hidden} more: see the events)" if hidden > 0 and place == _MOST_FAILED - 1 else ""
            rows.append(
                [
                    Segment(f"   {sign} {name}{why} ", theme.style(colour)),
                    Segment(advice(one) + more, theme.style(FAINT)),
                ]
            )
        self._put(rows)

    def show_sentence(self, sentence: str, colour: str = WARN) -> None:
        """Words instead of results."""
        self._put([[Segment(f" {clean(sentence, 300)}", theme.style(colour))]])

    def render_line(self, y: int) -> Strip:
        """One of the lines."""
        row = self._rows[y] if y < len(self._rows) else []
        return Strip(row).adjust_cell_length(self.size.width).apply_style(self.rich_style)

    def _put(self, rows: list[list[Segment]]) -> None:
        if rows != self._rows:
            self._rows = rows
            self.set_class(not rows, "empty")
            self.styles.height = max(1, len(rows))
            self.refresh()
