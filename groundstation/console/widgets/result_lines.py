"""The last order with the answer of each vehicle, as the answers come in.

A failure is shown with its reason and with advice.
"""

from __future__ import annotations

from collections import Counter

from rich.cells import cell_len
from rich.text import Text
from textual.widgets import Static

from groundstation.console import theme
from groundstation.console.theme import FAINT, TEXT, WARN, clean
from groundstation.orders.result import OrderResult, VehicleResult

_MAX_FAILURES_SHOWN = 3
_LONGEST_TITLE = 34  # cells
_ADVICE = {
    "no answer": "In the air: ctrl+l lands everybody, past silent agents too.",
    "failed": "Look at it; hold (F6) or land (F7) it, or give the order again.",
    "timed out": (
        "It is still where it stopped: hold (F6) or land (F7) it, or give the order again."
    ),
    "unfinished": "Watch it; hold (F6) or land (F7) it.",
    "refused": "Nothing was changed. Correct this, and give the order again.",
    "direct": "Watch it come down; RC switch ready.",
}


class ResultLines(Static):
    """One line for the order, and up to three lines for vehicles that did not carry it out."""

    def __init__(self) -> None:
        super().__init__(id="result", classes="empty")
        self.sentence = ""  # the shown sentence; empty while results are shown

    def show_order(self, order: OrderResult, text: str) -> None:
        """Show the text of the order and the results so far."""
        self.sentence = ""
        cleaned = clean(text, 60)
        title = theme.fit(cleaned, min(_LONGEST_TITLE, cell_len(cleaned)))
        line = Text.assemble((f" {title} ", theme.style(TEXT, bold=True)))

        width = (self.size.width or 80) - line.cell_len
        for words, colour in _answers(order, width):
            line.append(f"  {words}", theme.style(colour))

        # A result with advice is a failure, or a landing past a silent agent.
        failed = [result for result in order.results.values() if result.phase in _ADVICE]
        lines = [line]
        for result in failed[:_MAX_FAILURES_SHOWN]:
            lines.append(_failure(result))

        hidden = len(failed) - _MAX_FAILURES_SHOWN
        if hidden > 0:
            lines[-1].append(f" (+{hidden} more: see the events)", theme.style(FAINT))
        self._put(Text("\n").join(lines))

    def show_sentence(self, sentence: str, colour: str = WARN) -> None:
        """Show a sentence instead of results."""
        self.sentence = sentence
        self._put(Text(f" {clean(sentence, 300)}", theme.style(colour)))

    def _put(self, text: Text) -> None:
        self.remove_class("empty")
        self.update(text)


def _answers(order: OrderResult, width: int) -> list[tuple[str, str]]:
    """Return text and colour of the answer of each vehicle.

    Answers that do not all fit into ``width`` cells are counted by phase, so that failures stay in
    sight.
    """
    answers = []
    cells = 0
    for name, result in order.results.items():
        sign, colour = theme.PHASE_SIGNS.get(result.phase, ("?", WARN))
        words = f"{name} {sign} {result.phase}"
        answers.append((words, colour))
        cells += cell_len(words) + 2  # two blanks stand before each answer
    if cells <= width:
        return answers

    counted = []
    for phase, count in Counter(str(result.phase) for result in order.results.values()).items():
        sign, colour = theme.PHASE_SIGNS.get(phase, ("?", WARN))
        counted.append((f"{sign} {count} {phase}", colour))
    return counted


def _failure(result: VehicleResult) -> Text:
    sign, colour = theme.PHASE_SIGNS.get(result.phase, ("?", WARN))

    reason = clean(result.reason, 200) or result.phase
    words = (f"   {sign} {result.vehicle}: {reason} ", theme.style(colour))
    advice = (_ADVICE[result.phase], theme.style(FAINT))
    return Text.assemble(words, advice)
