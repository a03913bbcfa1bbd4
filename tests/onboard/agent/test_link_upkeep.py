"""What an agent reads of its PX4: parameters by its version, and of a simulated one where its
battery stops. After each restart of PX4 it requests everything again.
"""

from __future__ import annotations

import asyncio
from collections.abc import Mapping

import pytest
from msgspec.structs import replace

from onboard import agent_inputs
from onboard.agent import link_upkeep
from onboard.agent.link_upkeep import LinkUpkeep
from onboard.autopilot import Snapshot
from onboard.flight.context import FlightContext
from onboard.px4.required_params import required_params
from tests.onboard.agent.rig import fleet

CONFIG = fleet(("mav0", "mav1", "mav2"))


class MuteLink:
    """PX4 v1.18 with all parameters at 0, whose version arrives only when it is requested for the
    third time.
    """

    def __init__(self, *, is_simulated: bool = False) -> None:
        self.withholds_poses = False
        self.is_simulated = is_simulated
        self.requests = 0
        self.read: list[frozenset[str]] = []

    def snapshot(self) -> Snapshot:
        version = (1, 18) if self.requests >= 3 else None
        return Snapshot(heartbeat_ns=1 << 62, px4_version=version, is_simulated=self.is_simulated)

    def connect(self, timeout_s: float) -> bool:
        return True

    def request_rates(self) -> None:
        self.request_version()

    def request_version(self) -> None:
        self.requests += 1

    def settle_global_origin(self, *, sets_ours: bool) -> bool:
        return True

    def read_params(self, names: Mapping[str, float | int]) -> dict[str, float | int | None]:
        self.read.append(frozenset(names))
        values: dict[str, float | int | None] = dict(names)
        if "SIM_BAT_MIN_PCT" in names:
            values["SIM_BAT_MIN_PCT"] = 30.0
        return values


async def events_until(
    link: MuteLink, reads: int, *, applies_params: bool = False, **changes: object
) -> list[agent_inputs.AgentInput]:
    """What the upkeep tells until it has read parameters so often."""
    vehicle = replace(CONFIG.vehicles["mav0"], **changes)
    told = asyncio.Queue[agent_inputs.AgentInput]()
    flight = FlightContext(CONFIG, vehicle)
    upkeep = LinkUpkeep(
        fleet=CONFIG,
        vehicle=vehicle,
        link=link,  # type: ignore[arg-type]
        flight=flight,
        notify=told.put_nowait,
        applies_params=applies_params,
    )
    events: list[agent_inputs.AgentInput] = []
    upkeep.start()
    try:
        async with asyncio.timeout(10.0):
            while not events or len(link.read) < reads:
                events.append(await told.get())
    finally:
        upkeep.stop()
    while not told.empty():
        events.append(told.get_nowait())
    return events


class RestartingLink(MuteLink):
    """PX4 that restarts while its parameters are read, and whose clock has caught up by the end; or
    one whose cable is pulled meanwhile.
    """

    def __init__(self, counter: str) -> None:
        super().__init__()
        self.prepared = 0  # number of times that rates were requested
        self._counter = counter
        self._count = 0

    def snapshot(self) -> Snapshot:
        boot_ms = 20_000 + 10_000 * len(self.read)
        px4 = Snapshot(heartbeat_ns=1 << 62, px4_boot_ms=boot_ms)
        return replace(px4, **{self._counter: self._count})

    def request_rates(self) -> None:
        self.prepared += 1

    def read_params(self, names: Mapping[str, float | int]) -> dict[str, float | int | None]:
        if not self.read:
            self._count = 1
        return super().read_params(names)


@pytest.mark.parametrize("counter", ["restarts", "returns"])
async def test_rates_are_requested_again_after_a_restart_or_a_silence_while_parameters_are_read(
    monkeypatch: pytest.MonkeyPatch, counter: str
) -> None:
    monkeypatch.setattr(link_upkeep, "_LOOK_S", 0.01)
    link = RestartingLink(counter)
    events = await events_until(link, 2)
    assert link.prepared == 2
    read = [event.problems for event in events if isinstance(event, agent_inputs.ParamsRead)]
    assert any("are being read again" in " ".join(problems) for problems in read)


async def test_a_version_that_got_lost_is_requested_again_and_its_own_parameters_are_read_at_once(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(link_upkeep, "_LOOK_S", 0.01)
    link = MuteLink()
    await events_until(link, 2)
    vehicle = CONFIG.vehicles["mav0"]
    assert link.read[0] == set(required_params(CONFIG, vehicle))
    assert link.read[1] == set(required_params(CONFIG, vehicle, (1, 18)))
    assert "MAN_OVERRIDE_SPD" in link.read[1] - link.read[0]


@pytest.mark.parametrize(("is_simulated", "floor_frac"), [(True, 0.3), (False, 0.0)])
async def test_only_a_simulated_px4_is_asked_where_its_battery_stops(
    is_simulated: bool, floor_frac: float
) -> None:
    link = MuteLink(is_simulated=is_simulated)
    event = (await events_until(link, 1))[0]
    assert isinstance(event, agent_inputs.ParamsRead)
    assert event == agent_inputs.ParamsRead((), event.battery_floor_frac)
    assert event.battery_floor_frac == pytest.approx(floor_frac)
    assert ("SIM_BAT_MIN_PCT" in link.read[0]) == is_simulated


class DriftedLink(MuteLink):
    """PX4 whose COM_OF_LOSS_T differs, and which takes what is set."""

    def __init__(self) -> None:
        super().__init__()
        self.requests = 3  # its version is known
        self.values: dict[str, float | int] = {"COM_OF_LOSS_T": 1.0}
        self.lost: list[str] = []  # parameters whose next answer is lost
        self.armed_reads = 0  # PX4 is armed until parameters have been read this often
        self.applied: list[dict[str, float | int]] = []

    def snapshot(self) -> Snapshot:
        is_armed = len(self.read) < self.armed_reads
        return replace(super().snapshot(), is_armed=is_armed)

    def read_params(self, names: Mapping[str, float | int]) -> dict[str, float | int | None]:
        values = super().read_params(names) | self.values
        for name in self.lost:
            values[name] = None
        self.lost = []
        return values

    def apply_params(self, values: Mapping[str, float | int]) -> None:
        self.applied.append(dict(values))
        self.values.update(values)


@pytest.fixture
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(link_upkeep, "_LOOK_S", 0.01)
    monkeypatch.setattr(link_upkeep, "_REPEAT_S", 0.01)


def last_problems(events: list[agent_inputs.AgentInput]) -> tuple[str, ...]:
    return [event.problems for event in events if isinstance(event, agent_inputs.ParamsRead)][-1]


async def test_a_parameter_whose_answer_got_lost_is_set_after_the_next_reading(quick: None) -> None:
    link = DriftedLink()
    link.lost = ["COM_OF_LOSS_T"]
    events = await events_until(link, 3, applies_params=True)
    assert [set(values) for values in link.applied] == [{"COM_OF_LOSS_T"}]
    assert not last_problems(events)


async def test_parameters_are_set_once_px4_is_disarmed_and_not_before(quick: None) -> None:
    link = DriftedLink()
    link.armed_reads = 2
    events = await events_until(link, 3, applies_params=True)
    assert [set(values) for values in link.applied] == [{"COM_OF_LOSS_T"}]
    assert not last_problems(events)


async def test_parameters_that_depend_on_the_version_are_set_when_it_is_known(quick: None) -> None:
    link = DriftedLink()
    link.requests = 0
    link.values["MAN_OVERRIDE_SPD"] = 2.0
    events = await events_until(link, 4, applies_params=True)
    assert [set(values) for values in link.applied] == [{"COM_OF_LOSS_T"}, {"MAN_OVERRIDE_SPD"}]
    assert not last_problems(events)


async def test_what_a_person_changes_later_is_reported_and_not_set(
    quick: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(link_upkeep, "_READ_AGAIN_NS", 0)
    link = DriftedLink()
    del link.values["COM_OF_LOSS_T"]

    def change(names: Mapping[str, float | int]) -> dict[str, float | int | None]:
        if len(link.read) == 2:
            link.values["COM_OF_LOSS_T"] = 1.0
        return DriftedLink.read_params(link, names)

    monkeypatch.setattr(link, "read_params", change)
    events = await events_until(link, 5, applies_params=True)
    assert not link.applied
    assert "COM_OF_LOSS_T is 1" in last_problems(events)[0]


async def test_a_px4_that_does_not_take_what_is_set_is_not_told_for_ever(
    quick: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    link = DriftedLink()
    monkeypatch.setattr(link, "apply_params", link.applied.append)
    events = await events_until(link, 12, applies_params=True)
    assert len(link.applied) == 3
    assert "COM_OF_LOSS_T is 1" in last_problems(events)[0]


@pytest.mark.parametrize(("px4_position", "is_problem"), [("gps", True), ("vision", False)])
async def test_a_px4_that_flies_by_vision_needs_no_global_origin(
    px4_position: str, is_problem: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    link = MuteLink()
    monkeypatch.setattr(link, "settle_global_origin", lambda sets_ours: False)
    events = await events_until(link, 1, mocap_required=False, px4_position=px4_position)
    assert ("no global origin" in " ".join(last_problems(events))) is is_problem
