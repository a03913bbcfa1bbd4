"""The orders that exist: one class for each verb holds everything about that verb.

An order is written in three ways: as a line in the console, as a step of a mission file, and as a
call in Python::

    takeoff 0-1 1.2
    do = "takeoff", vehicles = "0-1", height_m = 1.2
    await fleet.takeoff(1.2, "0-1")

All three make the same intent, ``Takeoff(vehicles=("mav0", "mav1"), height_m=1.2)``. The fields of
an intent are the keys of the step and the arguments of the method; their comments are the meanings
in docs/mission-file.md. `usage` is what the console shows, `from_line` reads the console's words,
and `str(intent)` writes them again: for previews, for results and for logs.

An intent is not checked yet. `groundstation/orders/plan.py` checks it against the fleet and makes
one message for each vehicle.

A new verb is a class here and an entry in `INTENTS`. A verb that sends vehicles to goals says in
`groundstation/orders/goals.py` to which ones. Positions are in metres in the fleet frame, ENU.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar, Literal, NamedTuple, Self

import msgspec

from onboard.bus.schema import TO_EVERYBODY, OrderKind
from onboard.tuples import Xyz

DEFAULT_HEIGHT_M = 1.0
DEFAULT_EVERY_S = 3.0  # time between two waves of a take-off
LONGEST_MOVE_S = 3600.0  # longest duration of a move
LONGEST_EVERY_S = 600.0  # longest time between two waves

# "all", names or indices: "mav0,mav2", "0-1"; or a list of names
Names = str | tuple[str, ...]
Assign = Literal["ids", "nearest"]

Verb = Literal[
    "arm",
    "disarm",
    "takeoff",
    "move",
    "goto",
    "formation",
    "rotate",
    "yaw",
    "home",
    "bring_home",
    "land",
    "hold",
    "pause",
    "resume",
    "skip",
    "kill",
    "locate",
    "reboot",
    "disable",
    "enable",
    "swap",
]
PathVerb = Literal["load_path", "follow_path"]  # programs and missions give these; nobody types one


def means_all(vehicles: Names) -> bool:
    """Return whether vehicles as somebody wrote them mean all of the fleet or group.

    Args:
        vehicles: the word "all", alone or in a list; or names or indices.
    """
    return vehicles in ("all", ("all",))


class LineWords(NamedTuple):
    """The words of a line after its verb, as `groundstation/orders/grammar.py` has read them."""

    vehicles: tuple[str, ...]
    numbers: tuple[float, ...] = ()  # as many as one of the verb's `number_counts`
    options: Mapping[str, float] = {}  # the numbers after "in", "yaw" and "turned"
    goals: Mapping[str, Xyz] = {}  # vehicle -> goal, for goto
    formation: str = ""
    is_nearest: bool = False

    @property
    def duration_s(self) -> float:
        """Return the number after "in" [s]; 0 without one."""
        return self.options.get("in", 0.0)

    @property
    def yaw_deg(self) -> float | None:
        """Return the number after "yaw"; None without one."""
        return self.options.get("yaw")


class MessageValues(NamedTuple):
    """Values that an intent gives to the message to each vehicle, apart from the goal.

    They are fields of `Order`.
    """

    height_m: float | None = None
    duration_s: float = 0.0
    yaw_deg: float | None = None
    then_land: bool = False
    reason: str = ""
    follows: str = ""


class Intent(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """One order as it was written, before it is checked."""

    verb: ClassVar[Verb | PathVerb]
    kind: ClassVar[OrderKind]  # kind of the message to each vehicle

    # How the console writes the order.
    usage: ClassVar[str] = ""  # form of the line, shown when a line is not understood
    number_counts: ClassVar[tuple[int, ...]] = (0,)  # how many numbers may follow the vehicles
    options: ClassVar[tuple[str, ...]] = ()  # words that a number may follow, at the line's end
    must_name_vehicles: ClassVar[bool] = False  # otherwise a line without names means all
    # In a line without names, a first number without a point is a vehicle's index: "takeoff 1".
    first_number_is_vehicle: ClassVar[bool] = True

    # Where else the order is written, and how it is checked.
    is_mission_step: ClassVar[bool] = True  # `do` of a mission file may be this verb
    is_previewed: ClassVar[bool] = False  # the console shows a preview before it sends it
    is_joint: ClassVar[bool] = False  # when one vehicle is refused, nothing is sent to the others
    has_goals: ClassVar[bool] = False  # each vehicle gets a position: see goals.py
    is_start: ClassVar[bool] = False  # the motors may begin to turn: preflight must allow it
    waits_for_step: ClassVar[bool] = False  # a mission that is flown in steps stops before it
    # It keeps or brings a vehicle down, so vehicles that are not enabled may get it as well.
    brings_down: ClassVar[bool] = False
    # where a vehicle must be when it gets the order
    begins: ClassVar[Literal["on ground", "in air", "anywhere"]] = "anywhere"

    # Fields that the planning fills in. They are not keys of a mission file.
    planned_fields: ClassVar[tuple[str, ...]] = ("is_everybody",)

    vehicles: Names = "all"  # "all", a name, "0-2", "a,b" or a list
    # whether the order is to all without naming them: then it leaves out vehicles that cannot take
    # part, and a landing those that a pilot flies by hand
    is_everybody: bool = False
    timeout_s: float = 40.0  # the step fails if it is not done within this time

    @classmethod
    def from_line(cls, line: LineWords) -> Self:
        """Return the intent of a line of the console."""
        return cls(vehicles=line.vehicles)

    @property
    def do(self) -> str:
        """The verb, under the name that it has in a mission file."""
        return self.verb

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the vehicles; a fleet must have resolved "all" and indices before."""
        assert not isinstance(self.vehicles, str), f"'{self.vehicles}' is not resolved"
        return self.vehicles

    def message_values(self) -> MessageValues:
        """Return the values of the message to each vehicle."""
        return MessageValues()

    def kind_for(self, name: str) -> OrderKind:
        """Return the kind of the message to a vehicle; for most verbs it is the same for all."""
        return self.kind

    def __str__(self) -> str:
        return " ".join((self.verb, ",".join(self.names), *self._words()))

    def _words(self) -> list[str]:
        """Return the line's words after the vehicles."""
        return []


class Arm(Intent, frozen=True, kw_only=True):
    """Arm on the ground."""

    verb = "arm"
    kind = "arm"
    usage = "arm [WHO]"
    is_previewed = True
    is_start = True
    waits_for_step = True
    begins = "on ground"

    timeout_s: float = 15.0


class Disarm(Intent, frozen=True, kw_only=True):
    """Disarm on the ground."""

    verb = "disarm"
    kind = "disarm"
    usage = "disarm [WHO]"
    brings_down = True
    begins = "on ground"

    timeout_s: float = 15.0


class Takeoff(Intent, frozen=True, kw_only=True):
    """Climb to a height above the fleet's origin."""

    verb = "takeoff"
    kind = "takeoff"
    usage = (
        "takeoff [WHO] [HEIGHT] [by COUNT] [every SECONDS], "
        "for instance: takeoff all 1.0, or in waves of five: takeoff all 1.0 by 5"
    )
    number_counts = (0, 1)
    options = ("by", "every")
    is_previewed = True
    is_joint = True
    is_start = True
    waits_for_step = True
    begins = "on ground"

    height_m: float = 1.0  # above the fleet's origin
    by: int = 0  # number of vehicles in a wave; 0: all at once
    every_s: float = DEFAULT_EVERY_S  # from the arrival of a wave to the start of the next

    @classmethod
    def from_line(cls, line: LineWords) -> Self:
        """Return the order of a line of the console."""
        return cls(
            vehicles=line.vehicles,
            height_m=line.numbers[0] if line.numbers else DEFAULT_HEIGHT_M,
            by=round(line.options.get("by", 0.0)),
            every_s=line.options.get("every", DEFAULT_EVERY_S),
        )

    @property
    def waves(self) -> list[tuple[str, ...]]:
        """The vehicles of each wave, in the order of the fleet file."""
        names = self.names
        size = self.by
        if not size:
            size = max(1, len(names))  # `range` refuses a step of 0
        return [names[begin : begin + size] for begin in range(0, len(names), size)]

    def message_values(self) -> MessageValues:
        """Return the values of the message to each vehicle."""
        return MessageValues(height_m=self.height_m)

    def _words(self) -> list[str]:
        if not self.by:
            return [f"{self.height_m:g}"]
        return [f"{self.height_m:g}", f"by {self.by}", f"every {self.every_s:g}"]


class GoalIntent(Intent, frozen=True, kw_only=True):
    """An order that sends vehicles to goals, as fast as their limits allow, or slower."""

    kind = "move"
    is_previewed = True
    is_joint = True
    has_goals = True
    waits_for_step = True
    begins = "in air"

    duration_s: float = 0.0  # duration, if slower than the limits allow; 0: as fast as they allow
    # instead of a duration: the highest speed of the vehicle with the longest way
    speed_m_s: float | None = None
    # heading to turn to, counterclockwise from east; by default the present one
    yaw_deg: float | None = None

    def message_values(self) -> MessageValues:
        """Return the values of the message to each vehicle."""
        return MessageValues(duration_s=self.duration_s, yaw_deg=self.yaw_deg)

    def _words(self) -> list[str]:
        yaw_words = []
        if self.yaw_deg is not None:
            yaw_words = [f"yaw {self.yaw_deg:g}"]

        return [*yaw_words, *_duration_words(self.duration_s)]


class Move(GoalIntent, frozen=True, kw_only=True):
    """Send one vehicle to a goal, or several to the position of their present formation; before one
    is ordered, of the first formation in the fleet file.
    """

    verb = "move"
    usage = "move WHO X Y Z [yaw DEG] [in SECONDS], for instance: move all 2 0 1.2"
    number_counts = (3,)
    options = ("in", "yaw")
    must_name_vehicles = True
    planned_fields = (*Intent.planned_fields, "is_of_formation")

    position_enu_m: Xyz  # east, north, up in the fleet frame
    # whether the position is that of the formation although only one vehicle is left
    is_of_formation: bool = False

    @classmethod
    def from_line(cls, line: LineWords) -> Self:
        """Return the order of a line of the console."""
        x, y, z = line.numbers
        return cls(
            vehicles=line.vehicles,
            position_enu_m=(x, y, z),
            duration_s=line.duration_s,
            yaw_deg=line.yaw_deg,
        )

    def _words(self) -> list[str]:
        return [*_number_words(self.position_enu_m), *super()._words()]


class Goto(GoalIntent, frozen=True, kw_only=True):
    """Send each vehicle to its own goal; all are checked together, so they may change places."""

    verb = "goto"
    usage = (
        "goto NAME X Y Z [NAME X Y Z ...] [yaw DEG] [in SECONDS], "
        "for instance: goto mav0 2 0 1 mav1 0 2 1"
    )
    options = ("in", "yaw")
    planned_fields = (*Intent.planned_fields, "follows")

    goals: Mapping[str, Xyz]  # vehicle -> east, north, up in the fleet frame
    follows: str = ""  # the vehicle whose motion the goals follow; empty: they stay

    @classmethod
    def from_line(cls, line: LineWords) -> Self:
        """Return the order of a line of the console."""
        return cls(
            vehicles=line.vehicles,
            goals=dict(line.goals),
            duration_s=line.duration_s,
            yaw_deg=line.yaw_deg,
        )

    def message_values(self) -> MessageValues:
        """Return the values of the message to each vehicle."""
        return super().message_values()._replace(follows=self.follows)

    def __str__(self) -> str:
        if self.follows:
            return f"follow {self.follows}"

        goal_words = [
            f"{name} {' '.join(_number_words(goal))}" for name, goal in self.goals.items()
        ]
        return " ".join((self.verb, *goal_words, *self._words()))


class Formation(GoalIntent, frozen=True, kw_only=True):
    """Take up a formation at a position."""

    verb = "formation"
    usage = (
        "formation NAME [WHO] [SPACING] [X Y Z] [nearest] [turned DEG] [yaw DEG] [in SECONDS], "
        "for instance: formation triangle 1.6 0 1.2 1.0"
    )
    number_counts = (0, 1, 3, 4)
    options = ("in", "yaw", "turned")
    planned_fields = (*Intent.planned_fields, "takes")

    name: str  # a table [formations.NAME] of the mission or of the fleet file
    # position of the formation; None: the mean of the vehicles' positions
    position_enu_m: Xyz | None = None
    # distance of the two nearest slots, to which the formation is stretched
    spacing_m: float | None = None
    rotation_deg: float = 0.0  # angle by which it is turned, counterclockwise
    # ids: each vehicle has its own slot; nearest: the longest flight is as short as possible
    assign: Assign = "ids"
    takes: Mapping[str, str] | None = None  # slot owner -> the slot owner whose slot it takes

    @classmethod
    def from_line(cls, line: LineWords) -> Self:
        """Return the order of a line of the console."""
        numbers = list(line.numbers)

        spacing_m = None
        if len(numbers) in (1, 4):
            spacing_m = numbers.pop(0)

        position_enu_m = None
        if numbers:
            position_enu_m = (numbers[0], numbers[1], numbers[2])

        return cls(
            vehicles=line.vehicles,
            name=line.formation,
            position_enu_m=position_enu_m,
            spacing_m=spacing_m,
            rotation_deg=line.options.get("turned", 0.0),
            assign="nearest" if line.is_nearest else "ids",
            duration_s=line.duration_s,
            yaw_deg=line.yaw_deg,
        )

    def __str__(self) -> str:
        return " ".join((self.verb, self.name, ",".join(self.names), *self._words()))

    def _words(self) -> list[str]:
        words = []
        if self.spacing_m is not None:
            words.append(f"{self.spacing_m:g}")
        if self.position_enu_m is not None:
            words += _number_words(self.position_enu_m)
        if self.assign == "nearest":
            words.append("nearest")
        if self.rotation_deg:
            words.append(f"turned {self.rotation_deg:g}")
        return [*words, *super()._words()]


class Rotate(Intent, frozen=True, kw_only=True):
    """Turn the present formation; each vehicle flies straight to its new slot."""

    verb = "rotate"
    kind = "move"
    usage = "rotate [WHO] DEG [in SECONDS], for instance: rotate all 90"
    number_counts = (1,)
    first_number_is_vehicle = False
    options = ("in",)
    is_previewed = True
    is_joint = True
    has_goals = True
    waits_for_step = True
    begins = "in air"
    planned_fields = (*Intent.planned_fields, "center_enu_m")

    angle_deg: float  # angle to turn by, counterclockwise
    duration_s: float = 0.0  # as for move
    center_enu_m: Xyz | None = None  # the formation's position, about which it turns

    @classmethod
    def from_line(cls, line: LineWords) -> Self:
        """Return the order of a line of the console."""
        return cls(
            vehicles=line.vehicles,
            angle_deg=line.numbers[0],
            duration_s=line.duration_s,
        )

    def message_values(self) -> MessageValues:
        """Return the values of the message to each vehicle."""
        return MessageValues(duration_s=self.duration_s)

    def _words(self) -> list[str]:
        center_words = []
        if self.center_enu_m is not None:
            center_words = _number_words(self.center_enu_m)

        return [*center_words, f"{self.angle_deg:g}", *_duration_words(self.duration_s)]


class Yaw(Intent, frozen=True, kw_only=True):
    """Turn each vehicle to a heading, without changing its position."""

    verb = "yaw"
    kind = "move"
    usage = "yaw [WHO] DEG, for instance: yaw mav1 -90"
    number_counts = (1,)
    first_number_is_vehicle = False
    is_joint = True
    has_goals = True
    waits_for_step = True
    begins = "in air"

    yaw_deg: float  # heading, counterclockwise from east
    timeout_s: float = 15.0

    @classmethod
    def from_line(cls, line: LineWords) -> Self:
        """Return the order of a line of the console."""
        return cls(vehicles=line.vehicles, yaw_deg=line.numbers[0])

    def message_values(self) -> MessageValues:
        """Return the values of the message to each vehicle."""
        return MessageValues(yaw_deg=self.yaw_deg)

    def _words(self) -> list[str]:
        return [f"{self.yaw_deg:g}"]


class Hold(Intent, frozen=True, kw_only=True):
    """Stop at the present spot."""

    verb = "hold"
    kind = "hold"
    usage = "hold [WHO]"
    brings_down = True
    begins = "in air"

    timeout_s: float = 15.0


class Home(Intent, frozen=True, kw_only=True):
    """Fly back to the take-off spots of the fleet file, and land there."""

    verb: ClassVar[Verb | PathVerb] = "home"
    kind = "move"
    usage = "home [WHO] [HEIGHT] [in SECONDS], for instance: home all"
    number_counts = (0, 1)
    options = ("in",)
    is_previewed = True
    is_joint = True
    has_goals = True
    begins = "in air"

    # height of the way back; by default each keeps its own, or rises above its spot
    height_m: float | None = None
    duration_s: float = 0.0  # duration of the way back, as for move
    timeout_s: float = 90.0

    @classmethod
    def from_line(cls, line: LineWords) -> Self:
        """Return the order of a line of the console."""
        height_m = None
        if line.numbers:
            height_m = line.numbers[0]

        return cls(vehicles=line.vehicles, height_m=height_m, duration_s=line.duration_s)

    def message_values(self) -> MessageValues:
        """Return the values of the message to each vehicle."""
        return MessageValues(duration_s=self.duration_s, then_land=True)

    def _words(self) -> list[str]:
        height_words = []
        if self.height_m is not None:
            height_words = [f"{self.height_m:g}"]

        return [*height_words, *_duration_words(self.duration_s)]


class BringHome(Home, frozen=True, kw_only=True):
    """Fly back from any positions to take-off spots, assigned so that the ways do not cross."""

    verb = "bring_home"
    usage = "bring_home [WHO] [HEIGHT] [in SECONDS], for instance: bring_home all"
    planned_fields = (*Intent.planned_fields, "takes")

    # vehicle -> the vehicle on whose take-off spot it lands; None: not assigned yet
    takes: Mapping[str, str] | None = None


class Pause(Intent, frozen=True, kw_only=True):
    """Stop the clock of the paths: vehicles that fly a path brake along it."""

    verb = "pause"
    kind = "pause"
    usage = "pause [WHO], for instance: pause"
    is_mission_step = False
    begins = "in air"

    timeout_s: float = 5.0


class Resume(Intent, frozen=True, kw_only=True):
    """Let the clock of paused paths go on."""

    verb = "resume"
    kind = "resume"
    usage = "resume [WHO], for instance: resume"
    is_mission_step = False
    begins = "in air"

    timeout_s: float = 5.0


class Skip(Intent, frozen=True, kw_only=True):
    """Leave the paths and fly straight to their ends; then the mission goes on."""

    verb = "skip"
    kind = "skip"
    usage = "skip [WHO], for instance: skip all"
    is_mission_step = False
    is_previewed = True
    begins = "in air"

    timeout_s: float = 5.0


class Land(Intent, frozen=True, kw_only=True):
    """Land and disarm."""

    verb = "land"
    kind = "land"
    usage = "land [WHO]"
    brings_down = True

    def message_values(self) -> MessageValues:
        """Return the values of the message to each vehicle."""
        return MessageValues(reason=TO_EVERYBODY if self.is_everybody else "")


class Kill(Intent, frozen=True, kw_only=True):
    """Stop the motors at once, even in the air: the vehicles fall."""

    verb = "kill"
    kind = "kill"
    usage = "kill WHO, for instance: kill mav1"
    must_name_vehicles = True
    is_mission_step = False
    brings_down = True


class Locate(Intent, frozen=True, kw_only=True):
    """Play a tune, so that an operator sees which vehicles these are."""

    verb = "locate"
    kind = "locate"
    usage = "locate WHO, for instance: locate mav1"
    must_name_vehicles = True
    is_mission_step = False
    brings_down = True


class Reboot(Intent, frozen=True, kw_only=True):
    """Restart PX4, on the ground and disarmed."""

    verb = "reboot"
    kind = "reboot"
    usage = "reboot WHO, for instance: reboot mav1"
    must_name_vehicles = True
    is_mission_step = False
    brings_down = True
    begins = "on ground"

    timeout_s: float = 40.0


class Disable(Intent, frozen=True, kw_only=True):
    """Take a vehicle out of service: "all" excludes it, and it refuses to start."""

    verb = "disable"
    kind = "disable"
    usage = "disable WHO, for instance: disable mav1"
    must_name_vehicles = True
    is_mission_step = False
    begins = "on ground"

    timeout_s: float = 5.0


class Enable(Intent, frozen=True, kw_only=True):
    """Let a vehicle that was disabled take part in flights again."""

    verb = "enable"
    kind = "enable"
    usage = "enable WHO, for instance: enable mav1"
    must_name_vehicles = True
    is_mission_step = False

    timeout_s: float = 5.0


class Swap(Intent, frozen=True, kw_only=True):
    """Replace a vehicle by a spare, which gets its spot, its slots and its paths."""

    verb = "swap"
    kind = "stand_in"
    usage = "swap WHO SPARE, for instance: swap mav2 mav7"
    must_name_vehicles = True
    is_mission_step = False
    is_joint = True
    begins = "on ground"
    planned_fields = (*Intent.planned_fields, "slot_owner")

    timeout_s: float = 5.0
    # the vehicle whose spot, slots and paths the spare gets: the first one, or the vehicle that the
    # first one replaces
    slot_owner: str = ""

    @property
    def swapped(self) -> str:
        """The vehicle that is out of service after the swap."""
        return self.names[0]

    @property
    def spare(self) -> str:
        """The vehicle that takes part instead."""
        return self.names[1]

    def kind_for(self, name: str) -> OrderKind:
        """Return the kind of the message to a vehicle."""
        return self.kind if name == self.spare else "disable"

    def __str__(self) -> str:
        return " ".join((self.verb, *self.names))


class LoadPath(Intent, frozen=True, kw_only=True):
    """Send each vehicle a part of its path."""

    verb = "load_path"
    kind = "load_path"
    is_mission_step = False


class FollowPath(Intent, frozen=True, kw_only=True):
    """Follow the loaded paths; all vehicles start at one instant."""

    verb = "follow_path"
    kind = "follow_path"
    is_mission_step = False


# The verbs that an operator types, in the order in which they are listed.
INTENTS: dict[str, type[Intent]] = {
    intent.verb: intent
    for intent in (
        Arm,
        Disarm,
        Takeoff,
        Move,
        Goto,
        Formation,
        Rotate,
        Yaw,
        Home,
        BringHome,
        Land,
        Hold,
        Pause,
        Resume,
        Skip,
        Kill,
        Locate,
        Reboot,
        Disable,
        Enable,
        Swap,
    )
}
PATH_INTENTS: dict[PathVerb, type[Intent]] = {"load_path": LoadPath, "follow_path": FollowPath}


def for_fewer(intent: Intent, names: tuple[str, ...]) -> Intent:
    """Return an order for some of its vehicles; the others take no part.

    A vehicle that is left of several still flies to its slot of the formation.

    Args:
        intent: an order with the names of its vehicles.
        names: the vehicles that are left.
    """
    if names == intent.names:
        return intent
    if isinstance(intent, Goto):
        goals = {name: intent.goals[name] for name in names}
        return msgspec.structs.replace(intent, vehicles=names, goals=goals)
    if isinstance(intent, Move) and len(intent.names) > 1:
        return msgspec.structs.replace(intent, vehicles=names, is_of_formation=True)
    return msgspec.structs.replace(intent, vehicles=names)


def _number_words(values: Xyz) -> list[str]:
    return [f"{value:g}" for value in values]


def _duration_words(duration_s: float) -> list[str]:
    if not duration_s:
        return []
    return [f"in {duration_s:g} s"]
