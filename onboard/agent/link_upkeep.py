"""Upkeep of the link to PX4: waits for PX4, sets rates and origin, checks parameters.

It starts over whenever PX4 restarts or is heard again after a silence. For example, PX4 sends at
its default rates after its USB cable has been plugged in again.
"""

from __future__ import annotations

import asyncio
import logging
import time
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from typing import Any

from onboard import agent_inputs
from onboard.autopilot import LinkError, Snapshot, Version
from onboard.config.fleet import FleetConfig, Vehicle
from onboard.flight.context import FlightContext
from onboard.process import realtime
from onboard.px4.mavsdk_link import Px4Link
from onboard.px4.required_params import (
    BATTERY_FLOOR,
    RequiredParam,
    Value,
    differences,
    required_params,
    unmet,
)
from onboard.safety.failsafe_table import Situation

_REPEAT_S = 5.0  # time until the next check while there are problems
_LOOK_S = 1.0  # time until the next check while there are no problems
_RESTARTED = "PX4 has restarted: its parameters are being read again."
# Sets of parameters are sent at most this often after a start of PX4. One is not always enough: an
# answer may be lost, and PX4 may be armed, or its version unknown, at first.
_MAX_SETTINGS = 3
# time after which parameters are read again, because somebody may have changed them
_READ_AGAIN_NS = 15_000_000_000
_NO_ORIGIN = (
    "PX4 has no global origin yet, and gets no poses until it has: "
    "wait 3 s, and restart PX4 if that stays so."
)

log = logging.getLogger("covey.agent")


class LinkUpkeep:
    """Task beside the control loop; its blocking calls run on a thread.

    Args:
        fleet: the fleet file.
        vehicle: the agent's own vehicle.
        link: link to its PX4.
        flight: its flight; parameters are read on the ground only.
        notify: function that takes inputs for the core.
        applies_params: whether required parameters are set, and not only checked.
    """

    def __init__(
        self,
        fleet: FleetConfig,
        vehicle: Vehicle,
        link: Px4Link,
        flight: FlightContext,
        notify: Callable[[agent_inputs.AgentInput], None],
        *,
        applies_params: bool,
    ) -> None:
        self._fleet = fleet
        self._vehicle = vehicle
        self._link = link
        self._flight = flight
        self._notify = notify
        self._applies_params = applies_params
        self._absent: set[str] = set()  # optional parameters that this PX4 does not know
        self._settings_left = 0  # how often parameters may still be set
        self._blocking = ThreadPoolExecutor(1, thread_name_prefix="link")
        self._task: asyncio.Task[None] | None = None

    def start_threads(self) -> None:
        """Start the thread now, before the process takes its realtime priority for all threads."""
        self._blocking.submit(int)  # the first call starts the thread; int() does nothing

    def start(self) -> None:
        """Begin, in the running event loop."""
        self._task = asyncio.create_task(self._run())
        self._task.add_done_callback(_log_end)

    def stop(self) -> None:
        """End; a second call does nothing."""
        if self._task is not None:
            self._task.cancel()
        self._blocking.shutdown(wait=True, cancel_futures=True)

    async def _run(self) -> None:
        await self._connect()
        while True:
            # read before the preparation, because PX4 may restart during it
            beginnings = _beginnings(self._link.snapshot())
            await self._prepare()
            await self._watch(beginnings)
            self._absent.clear()
            log.warning("PX4 has restarted, or is heard again")
            if self._flight.step.situation is Situation.GROUND:
                self._notify(agent_inputs.ParamsRead((_RESTARTED,)))

    async def _connect(self) -> None:
        while True:
            try:
                if await self._in_thread(self._link.connect, 1.0):
                    log.info("PX4 answers at %s", self._vehicle.autopilot)
                    return
            except LinkError as error:
                log.error("%s", error)
                self._notify(agent_inputs.ParamsRead((str(error),)))
                await asyncio.sleep(_REPEAT_S)

    async def _prepare(self) -> None:
        """Request rates, and wait for a heartbeat."""
        self._link.withholds_poses = self._vehicle.mocap_required
        self._link.request_rates()
        requested_ns = time.monotonic_ns()
        # polled, because MAVSDK's threads set no Event to wait for
        while self._link.snapshot().heartbeat_ns < requested_ns:  # noqa: ASYNC110
            await asyncio.sleep(0.1)
        # PX4 was armed by an earlier run of this agent or by a pilot; nothing is changed in flight
        if self._link.snapshot().is_armed:
            log.warning("PX4 is armed already: its origin and its parameters are left as they are")
        self._settings_left = _MAX_SETTINGS if self._applies_params else 0

    def _required(self) -> list[RequiredParam]:
        """Return the required parameters for PX4's version, except unknown optional ones."""
        version = self._link.snapshot().px4_version
        required = required_params(self._fleet, self._vehicle, version)
        return [param for name, param in required.items() if name not in self._absent]

    async def _watch(self, beginnings: int) -> None:
        """Check parameters, origin and disk until PX4 restarts or returns after a silence.

        Parameters are set until all have once been as required; what a person changes later is only
        reported.
        """
        problems: tuple[str, ...] | None = None  # None: the parameters have not been read yet
        read_ns = 0  # when the parameters were last read
        read_for: Version | None = None  # PX4's version at that time
        has_origin = True

        while True:
            # the required parameters depend on the version, whose message may have been lost
            version = self._link.snapshot().px4_version
            if version is None:
                self._link.request_version()

            is_on_ground = self._flight.step.situation is Situation.GROUND
            if is_on_ground:
                has_origin = self._settle_origin()
            elif not self._vehicle.mocap_required:
                # PX4 may move its origin, and the message about it may be lost
                self._link.request_global_origin()

            # The parameters may be read in flight the first time. They are read again only on the
            # ground: after some time, for another version of PX4, and while there are problems.
            is_old = time.monotonic_ns() - read_ns > _READ_AGAIN_NS
            is_due_again = bool(problems) or version != read_for or is_old
            if problems is None or (is_due_again and is_on_ground):
                read_ns = time.monotonic_ns()
                read_for = version
                problems = await self._read_params(has_origin)

            # while the origin is missing, check every second
            pause_s = _LOOK_S
            if problems and has_origin:
                pause_s = _REPEAT_S
            await asyncio.sleep(pause_s)
            is_full = await self._in_thread(realtime.is_disk_full)
            self._notify(agent_inputs.DiskChecked(is_full))

            if _beginnings(self._link.snapshot()) != beginnings:
                return

    async def _read_params(self, has_origin: bool) -> tuple[str, ...]:
        px4 = self._link.snapshot()
        required = self._required()
        values = _values(required)
        if px4.is_simulated:
            values[BATTERY_FLOOR] = 0.0  # any float, because only its type matters for the reading
        actual = await self._in_thread(self._link.read_params, values)
        wrong = unmet(required, actual)
        if wrong and self._may_set():
            self._settings_left -= 1
            await self._in_thread(self._link.apply_params, _values(wrong))
            actual = await self._in_thread(self._link.read_params, values)

        for param in required:
            if param.is_optional and actual.get(param.name) is None:
                self._absent.add(param.name)

        problems = differences(required, actual)
        if not problems and px4.px4_version is not None:
            self._settings_left = 0
        if not has_origin:
            problems = (*problems, _NO_ORIGIN)
        battery_floor_pct = actual.get(BATTERY_FLOOR)
        if battery_floor_pct is None:
            battery_floor_pct = 0.0
        self._notify(agent_inputs.ParamsRead(problems, 0.01 * float(battery_floor_pct)))
        for sentence in problems:
            log.warning("%s", sentence)
        return problems

    def _settle_origin(self) -> bool:
        """Return whether PX4 has the global origin that it needs.

        A PX4 that flies by vision alone has none. Its poses come from another program, so none can
        be given to it: PX4 v1.18 does not bear a new origin while it fuses poses.
        """
        is_settled = self._link.settle_global_origin(sets_ours=self._vehicle.mocap_required)
        return is_settled or self._vehicle.flies_by_vision

    def _may_set(self) -> bool:
        """Return whether parameters may be set now: on the ground, disarmed, and not too often."""
        is_on_ground = self._flight.step.situation is Situation.GROUND
        return self._settings_left > 0 and is_on_ground and not self._link.snapshot().is_armed

    async def _in_thread(self, function: Callable[..., Any], *args: Any) -> Any:
        return await asyncio.get_running_loop().run_in_executor(self._blocking, function, *args)


def _beginnings(px4: Snapshot) -> int:
    """Return how often PX4 has restarted, or has returned after a silence."""
    return px4.restarts + px4.returns


def _values(required: Iterable[RequiredParam]) -> dict[str, Value]:
    """Return the required value of each parameter by its name."""
    return {param.name: param.value for param in required}


def _log_end(task: asyncio.Task[None]) -> None:
    """Log a bug that ended the upkeep; the flight continues without upkeep."""
    if not task.cancelled() and task.exception() is not None:
        log.error("upkeep of the link ended", exc_info=task.exception())
