"""The last order with each vehicle's answer as it comes in.

A failure says why, and what can be done.
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
    "timed out": (
        "It is still where it stopped: hold (F6) or land (F7) it, or give the order again."
    ),
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
        title = theme.fit(words, min(34, cell_len(words)))
        line = Text.assemble((f" {title} ", theme.style(TEXT, bold=True)))

        width = (self.size.width or 80) - line.cell_len
        for words, colour in _answers(order, width):
            line.append(f"  {words}", theme.style(colour))

        failed = [result for result in order.results.values() if result.phase in _ADVICE]
        lines = [line]
        for result in failed[:_MOST_FAILED]:
            lines.append(_failure(result))

        hidden = len(failed) - _MOST_FAILED
        if hidden > 0:
            lines[-1].append(f" (+{hidden} more: see the events)", theme.style(FAINT))
        self._put(Text("\n").join(lines))

    def show_sentence(self, sentence: str, colour: str = WARN) -> None:
        """Show words instead of results."""
        self._put(Text(f" {clean(sentence, 300)}", theme.style(colour)))

    def _put(self, text: Text) -> None:
        self.remove_class("empty")
        self.update(text)


def _answers(order: OrderResult, width: int) -> list[tuple[str, str]]:
    """Return words and colour of each vehicle's answer.

    Where all of them do not fit into ``width`` cells the answers are counted, so that failures stay
    in sight.
    """
    each = []
    cells = 0
    for name, result in order.results.items():
        sign, colour = theme.PHASE_SIGNS.get(result.phase, ("?", WARN))
        words = f"{name} {sign} {result.phase}"
        each.append((words, colour))
        cells += cell_len(words) + 2  # two blanks before each
    if cells <= width:
        return each

    counted = []
    for phase, count in Counter(str(result.phase) for result in order.results.values()).items():
        sign, colour = theme.PHASE_SIGNS.get(phase, ("?", WARN))
        counted.append((f"{sign} {count} {phase}", colour))
    return counted


def _failure(result: VehicleResult) -> Text:
    sign, colour = theme.PHASE_SIGNS.get(result.phase, ("?", WARN))

    reason = clean(result.sentence, 200) or result.phase
    if not reason.startswith(result.vehicle):
        reason = f"{result.vehicle}: {reason}"

    words = (f"   {sign} {reason} ", theme.style(colour))
    advice = (_ADVICE[result.phase], theme.style(FAINT))
    return Text.assemble(words, advice)
