"""The console for a recorded flight: the same screens, and a bar with the position in time."""

from __future__ import annotations

import time
from typing import ClassVar

from rich.cells import cell_len
from rich.segment import Segment
from textual.app import ComposeResult
from textual.binding import Binding, BindingType

from groundstation.alarms.alarms import Alarms
from groundstation.console import theme
from groundstation.console.app import ConsoleApp
from groundstation.console.screens.dialogs import REPLAY_HELP, HelpScreen
from groundstation.console.theme import BAD, CALM, FAINT, GOOD, RULE, SEVERITY_SIGNS, TEXT, WARN
from groundstation.console.widgets.bars import Bar
from groundstation.recording.replay import Replay

KEYS = "space play  , . step  ← → 5 s  n N event  < > speed"
_SKIP_S = 5.0
_STEP_S = 0.1
_MIN_TRACK = 24  # width of the track from which the keys are shown beside it
_ACTIONS = ("play_or_pause", "step", "skip", "jump", "speed", "go")  # of the replay's keys
# signs of events on the track; events of other severities only mark the line
_MARKS = {"warning": ("┃", WARN), "critical": ("┃", BAD)}


class ReplayBar(Bar):
    """The position in the flight, with a mark at each event."""

    def __init__(self, replay: Replay) -> None:
        super().__init__("replay")
        self.replay = replay

    def show(self) -> None:
        """Update the line."""
        replay = self.replay
        sign, colour = self._sign()
        position = f"{clock(replay.position_s)} / {clock(replay.length_s)}"
        damage = "  ✂ cut off or damaged" if replay.timeline.broken else ""
        left = f" {sign} {replay.speed:g}×  {position}{damage}  "

        keys = " "
        if self.size.width >= cell_len(left) + len(KEYS) + _MIN_TRACK:
            keys = f"  {KEYS} "

        room = max(0, self.size.width - cell_len(left) - cell_len(keys))
        segments = [
            Segment(left, theme.style(colour, bold=True)),
            *self._track(room),
            Segment(keys, theme.style(FAINT)),
        ]
        self.put(segments)

    def _sign(self) -> tuple[str, str]:
        """Return the sign and the colour of the present activity of the replay."""
        replay = self.replay
        if replay.seeking is not None:
            return f"… {100.0 * replay.seeking:.0f} %", CALM
        if replay.is_playing:
            return "▶", GOOD
        if replay.is_at_end:
            return "■", WARN
        return "‖", WARN

    def _track(self, width: int) -> list[Segment]:
        """Return the line through the flight, with its events and the present position."""
        if width < 5:
            return []

        timeline = self.replay.timeline
        columns_per_ns = (width - 1) / max(1, timeline.end_ns - timeline.begin_ns)

        def column_of(stamp_ns: int) -> int:
            column = round((stamp_ns - timeline.begin_ns) * columns_per_ns)
            return max(0, min(width - 1, column))

        now_column = column_of(self.replay.now_ns())
        cells = [("━", CALM) if column < now_column else ("─", RULE) for column in range(width)]

        for severity in ("info", "warning", "critical"):  # the worst event of a cell is drawn last
            for stamp_ns, event in timeline.events:
                if event.severity != severity:
                    continue
                column = column_of(stamp_ns)
                if severity in _MARKS:
                    cells[column] = _MARKS[severity]
                else:
                    _, colour = cells[column]
                    cells[column] = ("┿" if column < now_column else "┼", colour)

        cells[now_column] = ("●", TEXT)
        return [Segment(sign, theme.style(colour)) for sign, colour in cells]


class ReplayApp(ConsoleApp):
    """The console with a record as its client."""

    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("space", "play_or_pause", "play", priority=True),
        Binding("full_stop", "step(1)", "step", priority=True),
        Binding("comma", "step(-1)", "step back", priority=True),
        Binding("right", "skip(1)", "on", priority=True),
        Binding("left", "skip(-1)", "back", priority=True),
        Binding("n", "jump(1)", "next event", priority=True),
        Binding("N,b", "jump(-1)", "event before", priority=True),
        Binding("greater_than_sign", "speed(1)", "faster", priority=True),
        Binding("less_than_sign", "speed(-1)", "slower", priority=True),
        Binding("home", "go(0.0)", "begin", priority=True),
        Binding("end", "go(1.0)", "end", priority=True),
    ]

    def __init__(self, replay: Replay, *, title: str, at_s: float = 0.0) -> None:
        super().__init__(replay.fleet, replay, title=title)
        self.alarms = Alarms(replay.fleet, is_replay=True)
        self.replay = replay
        self.bar = ReplayBar(replay)
        self._begin_s = at_s
        self._played_s = time.monotonic()  # monotonic time up to which the replay was played on

        self.panels.order_line.disable("a recorded flight: there is nobody to order")
        replay.add_listener(self.history.add, self._forget)

    def compose(self) -> ComposeResult:
        """Yield the console's widgets, with the bar above the last line."""
        for widget in super().compose():
            if widget is self.panels.status:
                yield self.bar
            yield widget

    def on_mount(self) -> None:
        """Begin at the given time; Textual also calls the console's own ``on_mount``."""
        for note in self.replay.timeline.notes:
            self.panels.events.add(note, SEVERITY_SIGNS["warning"])
        if self._begin_s > 0.0:
            self._seek(self._begin_s)

    def refresh_fleet(self) -> None:
        """Play on to the present time, then draw."""
        now_s = time.monotonic()
        elapsed_s = now_s - self._played_s
        self._played_s = now_s
        self.replay.play(elapsed_s)

        super().refresh_fleet()
        self.bar.show()

    def time_text(self, stamp_ns: int) -> str:
        """Return the time since the record began."""
        return f"{clock((stamp_ns - self.replay.timeline.begin_ns) * 1e-9):>8}"

    def check_action(self, action: str, parameters: tuple[object, ...]) -> bool | None:
        """Refuse the keys of the replay while a text is written: there they are letters."""
        if self.is_writing and action in _ACTIONS:
            return False
        return super().check_action(action, parameters)

    def action_help(self) -> None:
        """Show the keys, those of the replay first."""
        self.push_screen(HelpScreen(REPLAY_HELP, self.panels.table))

    def action_play_or_pause(self) -> None:
        """Play or pause; at the end of the record, begin again."""
        if self.replay.is_at_end and not self.replay.is_playing:
            self._seek(0.0)
        self.replay.is_playing = not self.replay.is_playing

    def action_step(self, direction: int) -> None:
        """Move on or back by one picture, and pause."""
        self.replay.is_playing = False
        self._seek(self.replay.position_s + direction * _STEP_S)

    def action_skip(self, direction: int) -> None:
        """Move on or back by some seconds."""
        self._seek(self.replay.position_s + direction * _SKIP_S)

    def action_jump(self, direction: int) -> None:
        """Go to the next event, or to the one before."""
        self.run_worker(self.replay.jump(direction), group="jump", exclusive=True)

    def action_speed(self, steps: int) -> None:
        """Play faster or slower."""
        self.replay.change_speed(steps)

    def action_go(self, share: float) -> None:
        """Go to a share of the record."""
        self._seek(share * self.replay.length_s)

    def action_leave(self) -> None:
        """Quit without a question, because no vehicle flies in a replay."""
        self.exit(0)

    async def action_interrupt(self) -> None:
        """Quit."""
        self.exit(0)

    def _seek(self, position_s: float) -> None:
        self.run_worker(self.replay.seek(position_s), group="seek")

    def _forget(self) -> None:
        """Forget history and events, because the replay has jumped back to a time before them."""
        self.history.clear()
        self.forget_events()


def clock(seconds: float) -> str:
    """Return a time as hours, minutes, seconds and tenths, like the display of a player."""
    tenths = round(max(0.0, seconds) * 10)
    all_minutes, tenths = divmod(tenths, 600)
    hours, minutes = divmod(all_minutes, 60)

    if hours:
        return f"{hours}:{minutes:02d}:{tenths / 10:04.1f}"
    return f"{minutes}:{tenths / 10:04.1f}"
