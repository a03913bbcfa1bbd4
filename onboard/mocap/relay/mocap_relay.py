"""``covey mocap``: one process that reads the motion capture and publishes its bodies on the bus.

It publishes all bodies, whether they are vehicles or not. Agents use only the bodies in the fleet
file. It does not check the poses, because the agents do. It listens at the emulator's endpoint, so
a relay and an emulator cannot run at the same time.
"""

from __future__ import annotations

import re
import threading
import time
from collections.abc import Callable, Iterator

import msgspec

from onboard.bus.clock_sync import BEAT_S, ClockNode
from onboard.bus.pose_publisher import PosePublisher
from onboard.bus.schema import MocapPose
from onboard.bus.session import BusSession
from onboard.config.fleet import FleetConfig
from onboard.config.mocap import BODY_NAME
from onboard.exit_status import EXIT_FAILED, EXIT_NO_ANSWER, EXIT_OK
from onboard.mocap.relay.statistics import MocapStatistics
from onboard.mocap.sdk_source import SdkMocap
from onboard.security.credentials import credentials_of
from onboard.security.node_roles import NodeRole

NODE = "mocap"


def bodies_of(fleet: FleetConfig) -> dict[str, str]:
    """Return vehicle -> body, for all enabled vehicles that require a mocap."""
    bodies: dict[str, str] = {}
    for name in fleet.enabled_names:
        vehicle = fleet.vehicles[name]
        if vehicle.mocap_required and vehicle.body is not None:
            bodies[name] = vehicle.body
    return bodies


def mock_options(fleet: FleetConfig) -> dict[str, str]:
    """Return the options of the package ``motioncapture`` for its type ``mock``; none for other
    types.

    With these options each vehicle has a body that stands still at the vehicle's take-off spot.
    """
    if fleet.mocap.type != "mock":
        return {}

    rows: list[str] = []
    for name, body in bodies_of(fleet).items():
        position = ",".join(f"{value:g}" for value in fleet.vehicles[name].start_enu_m)
        rows.append(f"{body}({position},1,0,0,0)")
    return {"rigid_bodies": ";".join(rows), "frequency": "100"}


def report_times(
    clock: ClockNode, *, seconds: float | None, every_s: float, stopped: threading.Event
) -> Iterator[None]:
    """Yield whenever a report is due, and at the end. Meanwhile, publish this node's clock.

    Args:
        clock: publishes the clock of this node.
        seconds: the reports end after this time; None: never.
        every_s: time from one report to the next.
        stopped: event that ends the reports at once.
    """
    began_s = time.monotonic()
    reported_s = began_s
    while not stopped.wait(min(BEAT_S, every_s)):
        clock.beat()
        now_s = time.monotonic()
        is_over = seconds is not None and now_s - began_s >= seconds
        if is_over or now_s - reported_s >= every_s:
            reported_s = now_s
            yield
        if is_over:
            return


class MocapRelay:
    """One run of the relay.

    Args:
        fleet: the fleet file.
        say: prints a line for a person.
    """

    def __init__(self, fleet: FleetConfig, say: Callable[[str], None]) -> None:
        self.fleet = fleet
        self.say = say

        self._emulated = {fleet.vehicles[name].body for name in fleet.emulated_names}
        self.statistics = MocapStatistics(
            vehicles={
                name: body for name, body in bodies_of(fleet).items() if body not in self._emulated
            },
            people=fleet.people_bodies,
        )

        agents = [fleet.vehicles[name].agent for name in fleet.enabled_names]
        self._bus = BusSession(
            namespace=fleet.namespace,
            node=NODE,
            listen=[fleet.simulator_endpoint],
            connect=agents,
            credentials=credentials_of(fleet, NodeRole.MOCAP),
            routers=fleet.fleet.routers,
        )
        self._clock = ClockNode(self._bus)
        self._publisher = PosePublisher(self._bus)
        self._source = SdkMocap(
            fleet.mocap,
            "*",
            self._pass_on,
            lambda: None,  # no bytes arrive from outside, so none can be malformed
            node=NODE,
            default_options=mock_options(fleet),
        )

        self._lock = threading.Lock()  # protects the statistics, which the source's thread updates
        self._unnameable: set[str] = set()  # bodies whose names cannot be keys on the bus
        self._withheld: set[str] = set()  # bodies that are not published: the emulator sends them

    def run(self, *, seconds: float | None, every_s: float, stopped: threading.Event) -> int:
        """Relay until ``stopped`` is set or ``seconds`` have passed; return the exit status.

        Raises:
            BusError: another relay or an emulator listens at the endpoint.
        """
        self._bus.start()

        mocap = self.fleet.mocap
        hostname = "this computer"
        if mocap.hostname:
            hostname = mocap.hostname
        self.say(
            f"mocap: {mocap.type} at {hostname} -> bus "
            f"{self.fleet.namespace}/mocap/*, {mocap.latency_s * 1e3:.0f} ms subtracted from each "
            "stamp. Ctrl-C ends."
        )
        if mocap.direct:
            self.say(
                "  ! mocap.direct is true: the agents read the system themselves and do not "
                "listen to this relay."
            )

        was_complete = False
        try:
            self._clock.start()
            self._source.start()
            self.statistics.close_window(time.monotonic_ns())
            for _ in report_times(self._clock, seconds=seconds, every_s=every_s, stopped=stopped):
                was_complete = self._print(was_complete)
        finally:
            self._source.stop()
            self._bus.stop()

        if not self.statistics.bodies:
            return EXIT_NO_ANSWER
        if seconds is None or self.statistics.is_complete:
            return EXIT_OK
        return EXIT_FAILED

    def _print(self, was_complete: bool) -> bool:
        """Print a report, and return whether it is complete: see :class:`MocapStatistics`."""
        with self._lock:
            self.statistics.close_window(time.monotonic_ns())
            rows = list(self.statistics.rows())
            is_complete = self.statistics.is_complete
            unnameable = sorted(self._unnameable)
            withheld = sorted(self._withheld)
            body_count = len(self.statistics.bodies)

        vehicle_count = len(self.statistics.vehicles)
        self.say(f"{time.strftime('%H:%M:%S')} {body_count} bodies, {vehicle_count} vehicles")
        if body_count == 0:
            rows = ["  no pose has arrived yet"]
        for row in rows:
            self.say(row)

        if unnameable:
            names = ", ".join(map(repr, unnameable))
            self.say(
                "  ! Not published, because these names cannot be keys on the bus: "
                f"{names}. Rename them."
            )
        if withheld:
            names = ", ".join(map(repr, withheld))
            self.say(
                "  ! Not published, because the emulator sends the poses of these bodies: "
                f"{names}. Switch them off in the mocap's software, or remove emulated = true."
            )
        if self._source.problem:
            self.say(f"  ! {self._source.problem}")
        if is_complete and not was_complete:
            self.say("ready: every vehicle's body is tracked")
        return is_complete

    def _pass_on(self, pose: MocapPose, _received_ns: int) -> None:
        if not re.fullmatch(BODY_NAME, pose.body):
            self._unnameable.add(pose.body)
            return
        if pose.body in self._emulated:  # a body must not have two sources
            self._withheld.add(pose.body)
            return

        self._publisher.publish(pose)
        with self._lock:
            self.statistics.add(pose)


def with_source(fleet: FleetConfig, *, type_: str | None, hostname: str | None) -> FleetConfig:
    """Return the fleet with a motion-capture system other than the one in its file.

    Raises:
        msgspec.ValidationError: there is no such type.
    """
    if type_ is None and hostname is None:
        return fleet
    table = msgspec.to_builtins(fleet.mocap)
    table["source"] = "motioncapture"
    if type_:
        table["type"] = type_
    if hostname:
        table["hostname"] = hostname
    return msgspec.structs.replace(fleet, mocap=msgspec.convert(table, type(fleet.mocap)))
