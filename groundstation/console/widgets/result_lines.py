"""The last order with each vehicle's answer as it comes in; a failure says why, and what can be
done.
"""

from __future__ import annotations

from collections import Counter

from rich.cells import cell_len
from rich.text import Text
from textual.widgets import Static

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


class ResultLines(Static):
    """One line for the order, and up to three for vehicles that did not do it."""

    def __init__(self) -> None:
        super().__init__(id="result", classes="empty")

    def show_order(self, order: OrderResult, text: str) -> None:
        """Show the order's words and the results as they stand."""
        words = clean(text, 60)
        line = Text.assemble(
            (f" {theme.fit(words, min(34, cell_len(words)))} ", theme.style(TEXT, bold=True))
        )
        results = order.results
        width = (self.size.width or 80) - line.cell_len
        parts = [(f"{name} {{}} {one.phase}", str(one.phase)) for name, one in results.items()]
        if sum(cell_len(words) + 1 for words, _ in parts) > width:
            # Many vehicles: the phases are counted, so that failures stay in sight.
            counts = Counter(str(one.phase) for one in results.values())
            parts = [(f"{{}} {count} {phase}", phase) for phase, count in counts.items()]
        for words, phase in parts:
            sign, colour = theme.PHASE_SIGNS.get(phase, ("?", WARN))
            line.append(f"  {words.format(sign)}", theme.style(colour))
        failed = [one for one in results.values() if one.phase in _ADVICE]
        hidden = len(failed) - _MOST_FAILED
        lines = [line, *map(_failure, failed[:_MOST_FAILED])]
        if hidden > 0:
            lines[-1].append(f" (+{hidden} more: see the events)", theme.style(FAINT))
        self._put(Text("\n").join(lines))

    def show_sentence(self, sentence: str, colour: str = WARN) -> None:
        """Show words instead of results."""
        self._put(Text(f" {clean(sentence, 300)}", theme.style(colour)))

    def _put(self, text: Text) -> None:
        self.remove_class("empty")
        self.update(text)


def _failure(result: VehicleResult) -> Text:
    sign, colour = theme.PHASE_SIGNS.get(result.phase, ("?", WARN))
    reason = clean(result.sentence, 200) or result.phase
    name = "" if reason.startswith(result.vehicle) else f"{result.vehicle}: "
    words = (f"   {sign} {name}{reason} ", theme.style(colour))
    return Text.assemble(words, (_ADVICE[result.phase], theme.style(FAINT)))
