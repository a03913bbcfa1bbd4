"""The mission that the console flies: its worker, its line in the title, and its verdict.

The mission flies in a worker of Textual, so the screen stays alive. When it ends, the verdict
appears in a box and in the event log.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

from textual.app import App
from textual.worker import Worker, WorkerState

from groundstation.console import theme
from groundstation.console.panels import Panels
from groundstation.console.theme import SEVERITY_SIGNS
from groundstation.console.widgets.lines import Lines
from groundstation.missions.mission_orders import MissionCall

_FLIES = "mission flies"
_PASSED = "✔ mission passed"
_FAILED = "✖ mission failed"

# Exit statuses of failures that end the mission before its verdict.
_STATUS_BROKEN = 1
_STATUS_NO_CONNECTION = 2

_ALONE = "only-verdict"  # class of the screen while the verdict has all the room
_BOX_KEYS = "v enlarges · q quits"


class MissionWorker:
    """Opens the bus and flies the mission in workers, so that the screen waits for neither.

    Args:
        app: app whose workers are used.
        panels: panels that show the mission.
        mission: function that flies a mission and returns its verdict. The verdict may have
            ``sentences``, ``summary`` (one of the sentences), ``exit_status`` and ``passed``.
        connect: function that opens the bus.
        progress: function that returns one line about the mission; called at each refresh.
    """

    def __init__(
        self,
        app: App[int],
        panels: Panels,
        *,
        mission: MissionCall | None = None,
        connect: MissionCall | None = None,
        progress: Callable[[], str] | None = None,
    ) -> None:
        self._app = app
        self._panels = panels
        self._progress = progress
        self._mission = mission
        self._connect = connect
        self._mission_worker: Worker[object] | None = None
        self._connect_worker: Worker[object] | None = None
        self._line = ""  # the mission's state or outcome, for the title
        self.status = 0  # exit status of the console so far
        self.verdict: Sequence[str] = ()  # sentences of the verdict; empty before the end
        self.is_verdict_shown = False  # whether its box is to be seen where there is room for it
        self._were_down = False  # whether all were down at the last refresh since the verdict

    @property
    def has_mission(self) -> bool:
        """Whether this console was started for a mission, or flies one now."""
        return self._mission is not None or self.is_running

    @property
    def is_running(self) -> bool:
        """Whether the mission flies now."""
        return self._mission_worker is not None and self._mission_worker.is_running

    def start(self) -> None:
        """Start both workers."""
        if self._connect is not None:
            connecting = _awaited(self._connect)
            self._connect_worker = self._app.run_worker(connecting, exit_on_error=False)
        if self._mission is not None:
            self._run_in_worker(self._mission)

    def begin(self, mission: MissionCall, progress: Callable[[], str]) -> bool:
        """Fly a mission that the operator has started here, unless one flies already.

        Args:
            mission: function that flies the mission and returns its verdict.
            progress: function that returns one line about it.

        Returns:
            Whether the mission was begun.
        """
        if self.is_running:
            return False
        self._progress = progress
        self._run_in_worker(mission)
        return True

    def _run_in_worker(self, mission: MissionCall) -> None:
        self._line = _FLIES
        self._mission_worker = self._app.run_worker(self._fly(mission), exit_on_error=False)

    def cancel(self) -> None:
        """End the mission without a verdict."""
        if self._mission_worker is not None:
            self._mission_worker.cancel()

    @property
    def text(self) -> str:
        """The mission's line for the title: its progress while it flies, then its outcome."""
        if self.is_running and self._progress is not None:
            progress = self._progress()
            if progress:
                return progress
        return self._line

    def worker_changed(self, event: Worker.StateChanged) -> None:
        """Show a worker's error as a sentence; the operator can still give orders."""
        if event.state is not WorkerState.ERROR:
            return

        error = event.worker.error
        if event.worker is self._mission_worker:
            self.status = _STATUS_BROKEN
            reason = f"The mission broke off: {type(error).__name__}: {error}"
            self._show([reason, "Land with ctrl+l."], is_passed=False)
        elif event.worker is self._connect_worker:
            self.status = _STATUS_NO_CONNECTION
            sentence = f"No connection: {error} Press q to quit."
            self._panels.events.add(sentence, SEVERITY_SIGNS["critical"])

    def show_next_verdict_view(self) -> None:
        """Show the verdict in its box, then alone, then not at all."""
        if not self._panels.verdict.border_title:
            return

        screen = self._app.screen_stack[0]
        if not self.is_verdict_shown:
            self._show_box(is_shown=True)
        elif not screen.has_class(_ALONE):  # it is in its box
            screen.add_class(_ALONE)
            self._panels.verdict.border_subtitle = "v hides · q quits"
            self._panels.verdict.post_message(Lines.Alone("verdict"))
        else:
            self._show_box(is_shown=False)

    def note_flight(self, *, is_flying: bool) -> None:
        """Close the verdict's box as the next flight begins: the room is for its distances.

        Args:
            is_flying: whether any vehicle is in the air now.
        """
        begins = is_flying and self._were_down
        self._were_down = not is_flying
        if begins and self.is_verdict_shown:
            self._show_box(is_shown=False)

    def count_hidden_lines(self) -> None:
        """Say in the border of the verdict's box how many of its lines have no room."""
        box = self._panels.verdict
        if not box.display or self._app.screen_stack[0].has_class(_ALONE):
            return

        shown = box.content_size
        all_rows = box.get_content_height(shown, self._app.size, shown.width)
        hidden = all_rows - shown.height
        box.border_subtitle = _BOX_KEYS
        if hidden > 0:
            box.border_subtitle = f"↓ +{hidden} more · {_BOX_KEYS}"

    async def _fly(self, mission: MissionCall) -> object:
        verdict = await mission()
        sentences = getattr(verdict, "sentences", None)
        if not sentences:
            sentences = str(verdict).splitlines()

        status = _exit_status(verdict)
        # If several missions were flown, the first one that has failed decides.
        if self.status == 0:
            self.status = status
        self._show(
            [theme.clean(sentence) for sentence in sentences],
            is_passed=status == 0,
            summary=theme.clean(getattr(verdict, "summary", "")),
        )
        return verdict

    def _show(self, sentences: Sequence[str], *, is_passed: bool, summary: str = "") -> None:
        """Show a verdict.

        Args:
            sentences: all sentences of the verdict.
            is_passed: whether the mission has passed.
            summary: the sentence with the reason. It comes first in the box, which may be too low
                for all sentences.
        """
        self.verdict = sentences
        self._were_down = False
        self._line = _PASSED if is_passed else _FAILED

        lines = list(sentences)
        if summary in lines:
            lines.remove(summary)
            lines.insert(0, summary)

        box = self._panels.verdict
        box.border_title = self._line
        box.set_class(not is_passed, "bad")
        box.update("\n".join(lines))
        self._show_box(is_shown=True)

        sign = SEVERITY_SIGNS["info" if is_passed else "warning"]
        for sentence in sentences:
            self._panels.events.add(sentence, sign)

    def _show_box(self, *, is_shown: bool) -> None:
        """Show or hide the verdict's box below plan and events."""
        self.is_verdict_shown = is_shown
        self._panels.verdict.border_subtitle = _BOX_KEYS

        self._app.screen_stack[0].remove_class(_ALONE)
        self._panels.verdict.post_message(Lines.Alone(""))  # no panel has all the room now


def _exit_status(verdict: object) -> int:
    """Return a verdict's exit status; a verdict without one gives 0 if it has passed, else 1."""
    status = getattr(verdict, "exit_status", None)
    if isinstance(status, int):
        return status
    if getattr(verdict, "passed", True):
        return 0
    return 1


async def _awaited(function: MissionCall) -> object:
    """Await what a function returns: a worker takes a coroutine, but no other awaitable."""
    return await function()
