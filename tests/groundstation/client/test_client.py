"""The client on a real bus with a fake agent, and on a fake bus with silent ones."""

from __future__ import annotations

import asyncio
import itertools
import socket
import threading
import tomllib
from collections.abc import Callable
from typing import Any

import msgspec
import pytest

from groundstation.client import bus_feed, open_orders
from groundstation.client.client import FleetClient
from groundstation.client.direct_mavlink import DirectCommand, DirectResult, send_direct
from groundstation.client.mavlink_port import mavutil_address
from groundstation.orders.grammar import OrderError
from groundstation.orders.intents import Takeoff
from groundstation.processes.free_ports import with_free_ports
from onboard.bus.codec import Malformed
from onboard.bus.protocol import BusError, UntrustedOrder
from onboard.bus.schema import Event, Order, OrderReply, TickBatch
from onboard.bus.session import BusSession
from onboard.bus.topics import Topic
from onboard.config.fleet import FleetConfig, fleet_from_mapping
from tests.groundstation.recorded import tick


@pytest.fixture
def private_fleet(fleet: FleetConfig) -> FleetConfig:
    return fleet_from_mapping(with_free_ports(tomllib.loads(fleet.text), fleet))


async def _never(command: DirectCommand) -> DirectResult:
    pytest.fail(f"{command.kind} went straight to PX4")


async def test_a_bus_that_could_not_be_opened_is_not_started_and_is_opened_by_a_second_call(
    private_fleet: FleetConfig,
) -> None:
    endpoint = private_fleet.vehicles["mav0"].agent
    taken = BusSession(
        namespace=private_fleet.namespace, node="taken", listen=[endpoint], connect=[]
    )
    bus = BusSession(namespace=private_fleet.namespace, node="mav0", listen=[endpoint], connect=[])
    client = FleetClient(private_fleet, bus=bus)
    taken.start()
    try:
        with pytest.raises(BusError):
            await client.start()
        assert not client.is_started
    finally:
        taken.stop()

    await client.start()
    assert client.is_started
    client.announce_recording(True)
    await client.stop()


async def test_an_agent_on_a_real_bus_is_seen_ordered_and_heard(
    private_fleet: FleetConfig, make_telemetry: Callable[..., Any]
) -> None:
    agent = BusSession(
        namespace=private_fleet.namespace,
        node="mav0",
        listen=[private_fleet.vehicles["mav0"].agent],
        connect=[],
    )
    loop = asyncio.get_running_loop()
    got: list[Order] = []

    def answer(
        order: Order | Malformed | UntrustedOrder, reply: Callable[[OrderReply], None]
    ) -> None:
        assert isinstance(order, Order)
        got.append(order)
        loop.call_soon_threadsafe(finish, order, reply)

    def finish(order: Order, reply: Callable[[OrderReply], None]) -> None:
        accepted = order.kind != "arm"
        reply(
            OrderReply(
                order_id=order.order_id,
                vehicle="mav0",
                is_accepted=accepted,
                reason="" if accepted else "No.",
            )
        )
        if accepted:
            event = Event(
                vehicle="mav0",
                stamp_ns=1,
                severity="info",
                code="order",
                sentence="Landed.",
                order_id=order.order_id,
                order_outcome="done",
            )
            loop.call_later(0.05, agent.publish, Topic.EVENT, "mav0", event)

    own_hash = private_fleet.config_hash

    async def publish_for_ever() -> None:
        # like telemetry: what is sent before the bus knows its hearers is lost
        for sequence in itertools.count():
            told = make_telemetry("mav0", sequence=sequence, config_hash=own_hash)
            agent.publish(Topic.TELEMETRY, "mav0", told)
            # a name that is not the key's
            agent.publish(Topic.TELEMETRY, "mav1", make_telemetry("mav2"))
            await asyncio.sleep(0.05)

    await asyncio.to_thread(agent.start)
    agent.serve_orders("mav0", answer)
    client = FleetClient(private_fleet, author="tester", extra_topics=(Topic.STATE,))
    heard: list[tuple[Topic, str]] = []
    client.add_sink(lambda topic, name, message, now_ns: heard.append((topic, name)))
    await client.start()
    try:
        assert await client.wait_for(lambda state: state.vehicles["mav0"].is_alive, 10.0)
        beat = asyncio.create_task(publish_for_ever())
        assert await client.wait_for(
            lambda state: state.vehicles["mav0"].telemetry is not None, 5.0
        )
        landed = (await client.order("land mav0", 5.0))["mav0"]
        assert (landed.phase, landed.sentence) == ("done", "Landed.")
        refused = (await client.order("arm mav0", 5.0))["mav0"]
        assert (refused.phase, refused.sentence) == ("refused", "No.")
        assert await client.wait_for(lambda state: state.refused > 0, 5.0)
        beat.cancel()
        assert [order.author for order in got] == ["tester", "tester"]
        assert {(Topic.ORDER, "mav0"), (Topic.TELEMETRY, "mav0"), (Topic.EVENT, "mav0")} <= set(
            heard
        )
        await asyncio.to_thread(agent.stop)
        assert await client.wait_for(lambda state: not state.vehicles["mav0"].is_alive, 10.0)
    finally:
        await client.stop()
        await asyncio.to_thread(agent.stop)


async def test_the_values_of_a_vehicle_that_is_looked_at_come_over_a_real_bus(
    private_fleet: FleetConfig,
) -> None:
    agent = BusSession(
        namespace=private_fleet.namespace,
        node="mav0",
        listen=[private_fleet.vehicles["mav0"].agent],
    )
    await asyncio.to_thread(agent.start)
    client = FleetClient(private_fleet, author="tester")
    await client.start()
    try:
        client.tick_stream.follow("mav0")
        async with asyncio.timeout(10.0):
            while not client.tick_stream.values:
                agent.publish(
                    Topic.TICK,
                    "mav0",
                    TickBatch(vehicle="mav0", boot_id=1, sequence=1, ticks=(tick(1),)),
                )
                await asyncio.sleep(0.02)
    finally:
        await client.stop()
        await asyncio.to_thread(agent.stop)


async def test_who_hears_an_event_over_a_real_bus_finds_the_state_that_was_told_before_it(
    private_fleet: FleetConfig,
    make_telemetry: Callable[..., Any],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    # telemetry comes with the events alone, and not by chance with the periodic delivery
    monkeypatch.setattr(bus_feed, "DELIVERY_PERIOD_S", 60.0)
    agent = BusSession(
        namespace=private_fleet.namespace,
        node="mav0",
        listen=[private_fleet.vehicles["mav0"].agent],
    )
    await asyncio.to_thread(agent.start)
    client = FleetClient(private_fleet, author="tester")
    found: list[tuple[str, str]] = []

    def hear(event: Event) -> None:
        told = client.state.vehicles["mav0"].telemetry
        if event.vehicle == "mav0" and told is not None:
            found.append((event.code, told.order_id))

    client.add_event_listener(hear)
    await client.start()
    try:
        async with asyncio.timeout(15.0):
            for number in itertools.count():
                agent.publish(
                    Topic.TELEMETRY,
                    "mav0",
                    make_telemetry("mav0", sequence=number, order_id=str(number)),
                )
                # Events have a higher priority: one that is sent while the telemetry still waits in
                # its queue would overtake it.
                await asyncio.sleep(0.02)
                event = Event(
                    vehicle="mav0",
                    stamp_ns=number,
                    severity="info",
                    code=str(number),
                    sentence="Done.",
                )
                await asyncio.to_thread(agent.publish, Topic.EVENT, "mav0", event)
                await asyncio.sleep(0.005)
                if len(found) >= 30:
                    break
    finally:
        await client.stop()
        await asyncio.to_thread(agent.stop)
    # a later one may have come meanwhile
    assert all(int(told) >= int(code) for code, told in found), found


async def test_a_line_that_is_no_order_sends_nothing(client: Any, bus: Any) -> None:
    with pytest.raises(OrderError):
        await client.submit("land evrybody")
    assert not bus.orders


async def test_waves_of_half_a_vehicle_are_refused_in_the_results(client: Any, bus: Any) -> None:
    order = Takeoff(vehicles=("mav0", "mav1"), by=2.5)  # type: ignore[arg-type]
    results = (await client.submit(order)).results
    assert {result.phase for result in results.values()} == {"refused"}
    assert "'takeoff.by': it must be a whole number" in results["mav0"].sentence
    assert not bus.orders


async def test_what_the_check_before_sending_passed_is_what_is_sent(client: Any, bus: Any) -> None:
    assert await client.wait_for(lambda state: client.control.is_operator, 5.0)
    planned = client.plan("move mav1 0 1 1")
    checked = client.check_again(planned)
    assert checked.orders["mav1"].stamp_ns > planned.orders["mav1"].stamp_ns
    results = await client.send(checked).wait(5.0)
    assert results["mav1"].is_done
    assert bus.orders == [("mav1", checked.orders["mav1"])]
    assert checked.orders["mav1"].position_enu_m == planned.orders["mav1"].position_enu_m


async def test_an_order_planned_before_control_went_to_another_is_not_sent(
    client: Any, bus: Any
) -> None:
    assert await client.wait_for(lambda state: client.control.is_operator, 5.0)
    planned = client.plan("move mav1 0 1 1")
    client.control.hand_over()
    checked = client.check_again(planned)
    assert not checked.orders
    assert "nobody operates" in checked.refusals["mav1"]


async def test_each_vehicle_has_its_own_result_and_progress_comes_as_it_happens(
    client: Any, bus: Any
) -> None:
    bus.misbehave = {"mav0": "refuse", "mav1": "stuck"}
    handle = await client.submit("takeoff all 1.0")
    seen: list[tuple[str, str]] = []
    handle.add_listener(lambda result: seen.append((result.vehicle, result.phase)))
    results = await handle.wait(0.5)
    assert {name: result.phase for name, result in results.items()} == {
        "mav0": "refused",
        "mav1": "unfinished",
        "mav2": "done",
    }
    assert results["mav0"].sentence == "Because I say so."
    assert "0.5 s" in results["mav1"].sentence
    assert seen.index(("mav2", "accepted")) < seen.index(("mav2", "done"))


async def test_an_order_from_another_thread_is_sent_while_the_loop_does_not_get_on(
    client: Any, bus: Any
) -> None:
    handles: list[Any] = []
    sender = threading.Thread(target=lambda: handles.append(client.submit_now("land all")))
    sender.start()
    sender.join(5.0)
    assert len(bus.orders) == len(client.fleet.enabled_names)
    results = await handles[0].wait(10.0)
    assert {result.phase for result in results.values()} == {"done"}


async def test_an_order_may_be_sent_while_the_open_orders_are_looked_through(
    client: Any, bus: Any
) -> None:
    """The terminal's thread may send one at any moment, here while a kind is compared."""
    client.submit_now("land mav0")

    class Kinds(list[str]):
        def __contains__(self, kind: object) -> bool:
            client.submit_now("land mav1")
            return super().__contains__(kind)

    assert not client._orders.has_open("mav0", Kinds(["takeoff"]))
    assert client._orders.has_open("mav0", Kinds(["land"]))


async def test_an_agent_that_does_not_answer_is_said_to_and_the_others_go_on(
    client: Any, bus: Any
) -> None:
    bus.misbehave["mav1"] = "silent"
    results = await client.order("takeoff all 1.0", 5.0)
    assert results["mav1"].phase == "no answer"
    assert "did not answer" in results["mav1"].sentence
    assert results["mav0"].is_done


@pytest.mark.parametrize("verb", ["land", "kill"])
async def test_kill_and_land_go_straight_to_px4_when_the_agent_is_silent(
    fleet: FleetConfig, bus: Any, verb: str
) -> None:
    sent: list[tuple[Any, ...]] = []

    async def send(command: DirectCommand) -> DirectResult:
        sent.append((command.endpoint, command.system_id, command.kind))
        return DirectResult(True, True, "PX4 accepted it, and it is disarmed")

    bus.misbehave["mav1"] = "silent"
    client = FleetClient(fleet, author="tester", bus=bus, send=send)
    await client.start()
    bus.tell("mav1", is_armed=True, is_airborne=True)
    results = await client.order(f"{verb} all", 5.0)
    await client.stop()

    killed = [logged.event for logged in client.state.events if logged.event.code == "killed"]
    expected_kills = [("mav1", "critical")] if verb == "kill" else []
    assert [(event.vehicle, event.severity) for event in killed] == expected_kills
    assert all("by order of tester (from ground-test)" in event.sentence for event in killed)

    ((endpoint, system_id, kind),) = sent
    assert (endpoint, system_id, kind) == ("udpout://127.0.0.1:18571", 2, verb)
    assert results["mav1"].is_done
    limit_s = {"land": "1", "kill": "0.3"}[verb]
    assert f"did not answer within {limit_s} s" in results["mav1"].sentence

    repeated = [one.event for one in client.state.events if one.event.code == "land_repeated"]
    expected_repeats = ["mav1"] if verb == "land" else []
    assert [event.vehicle for event in repeated] == expected_repeats
    assert all("straight to PX4 in 0.7 s" in event.sentence for event in repeated)
    sent_orders = [order for name, order in bus.orders if name == "mav1"]
    assert len({order.order_id for order in sent_orders}) == 1
    assert len(sent_orders) == {"land": 4, "kill": 1}[verb]
    assert "straight to PX4" in results["mav1"].sentence


async def test_a_kill_that_is_accepted_but_shows_no_effect_goes_straight_to_px4(
    fleet: FleetConfig, bus: Any
) -> None:
    sent: list[str] = []

    async def send(command: DirectCommand) -> DirectResult:
        sent.append(command.kind)
        return DirectResult(True, True, "PX4 accepted it, and it is disarmed")

    bus.misbehave["mav1"] = "stuck"
    client = FleetClient(fleet, bus=bus, send=send)
    await client.start()
    results = await client.order("kill all", 5.0)
    await client.stop()
    assert sent == ["kill"]
    assert all(result.is_done for result in results.values()), results
    assert "accepted kill, but the vehicle did not show it" in results["mav1"].sentence


@pytest.mark.parametrize("verb", ["land", "kill"])
async def test_an_order_accepted_by_an_agent_that_does_not_hear_px4_goes_straight_to_px4(
    fleet: FleetConfig, bus: Any, verb: str
) -> None:
    sent: list[str] = []

    async def send(command: DirectCommand) -> DirectResult:
        sent.append(command.kind)
        return DirectResult(True, True, "PX4 accepted it, and it is disarmed")

    bus.misbehave["mav1"] = "stuck"
    client = FleetClient(fleet, bus=bus, send=send)
    await client.start()
    handle = await client.submit(f"{verb} mav1")
    while not handle.is_final:
        bus.tell("mav1", is_armed=True, is_airborne=True, autopilot_age_s=2.5)
        await asyncio.sleep(0.02)
    await client.stop()
    assert sent == [verb]
    assert handle.is_done
    assert "does not hear PX4" in handle.results["mav1"].sentence


@pytest.mark.parametrize(
    "gone", [{"autopilot_age_s": 2.5}, {"autopilot_age_s": 0.6, "conditions": ("PX4 silent",)}]
)
@pytest.mark.parametrize("verb", ["land", "kill"])
async def test_an_order_that_an_agent_ends_because_its_px4_is_gone_goes_straight_to_px4_once(
    fleet: FleetConfig, bus: Any, verb: str, gone: dict[str, Any]
) -> None:
    sent: list[str] = []

    async def send(command: DirectCommand) -> DirectResult:
        sent.append(command.kind)
        return DirectResult(True, True, "PX4 accepted it, and it is disarmed")

    bus.misbehave["mav1"] = "fail"
    client = FleetClient(fleet, bus=bus, send=send)
    await client.start()
    bus.tell("mav1", is_armed=True, is_airborne=True, **gone)
    results = await client.order(f"{verb} mav1", 5.0)
    await client.stop()
    assert sent == [verb]
    assert results["mav1"].is_done
    assert "straight to PX4" in results["mav1"].sentence


@pytest.mark.parametrize(("is_by_mission", "said"), [(True, 2), (False, 6)])
async def test_a_mission_that_lands_again_past_an_agent_says_the_same_once(
    fleet: FleetConfig, bus: Any, is_by_mission: bool, said: int
) -> None:
    bus.misbehave["mav1"] = "fail"

    async def send(_: DirectCommand) -> DirectResult:
        return DirectResult(False, False, "PX4 did not answer")

    client = FleetClient(fleet, bus=bus, send=send)
    await client.start()
    bus.tell("mav1", is_armed=True, is_airborne=True, autopilot_age_s=2.5)
    for _ in range(3):
        handle = client.send(client.plan("land mav1"), is_by_mission=is_by_mission)
        await handle.wait(5.0)
    await asyncio.sleep(0.2)  # events are delivered a few times a second
    events = [logged.event for logged in client.state.events]
    await client.stop()
    assert len([event for event in events if "straight to PX4" in event.sentence]) == said


async def test_a_landing_that_fails_although_px4_is_heard_has_failed(
    fleet: FleetConfig, bus: Any
) -> None:
    bus.misbehave["mav1"] = "fail"
    client = FleetClient(fleet, bus=bus, send=_never)
    await client.start()
    bus.tell("mav1", is_armed=True, is_airborne=True, autopilot_age_s=0.02)
    results = await client.order("land mav1", 5.0)
    await client.stop()
    assert results["mav1"].phase == "failed"


async def test_an_order_whose_end_was_lost_with_the_link_does_not_stay_open(
    client: Any, bus: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(open_orders, "LOST_END_S", 0.3)
    bus.misbehave["mav1"] = "stuck"
    handle = await client.submit("move mav1 0 1 1")
    bus.tell("mav1", order_id=handle.planned.orders["mav1"].order_id)
    await asyncio.sleep(0.5)
    assert handle.results["mav1"].phase == "accepted"
    bus.tell("mav1", order_id="", state="holding", reason="Neighbour silent.")
    result = (await handle.wait(5.0))["mav1"]
    assert result.phase == "failed"
    assert "how it ended was not heard: it is holding. Neighbour silent." in result.sentence


@pytest.mark.parametrize(("is_armed", "phase"), [(True, "failed"), (False, "done")])
async def test_a_landing_whose_agent_restarts_ends(
    client: Any, bus: Any, monkeypatch: pytest.MonkeyPatch, *, is_armed: bool, phase: str
) -> None:
    monkeypatch.setattr(open_orders, "LOST_END_S", 0.3)
    bus.misbehave["mav1"] = "stuck"
    handle = await client.submit("land mav1")
    bus.tell("mav1", order_id=handle.planned.orders["mav1"].order_id, is_armed=True)
    await asyncio.sleep(0.5)
    assert handle.results["mav1"].phase == "accepted"

    reason = "PX4 flies without this agent."
    bus.tell("mav1", boot_id=2, order_id="", state="failed", is_armed=is_armed, reason=reason)
    result = (await handle.wait(5.0))["mav1"]
    assert result.phase == phase
    assert "was not heard" in result.sentence


async def test_orders_that_have_ended_are_forgotten_and_some_without_an_answer_are_kept(
    client: Any, bus: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(open_orders, "REPLY_TIMEOUT_S", 0.02)
    monkeypatch.setattr(open_orders, "_MAX_UNANSWERED", 3)
    bus.misbehave["mav1"] = "refuse"
    for _ in range(10):
        assert (await client.order("hold mav1", 5.0))["mav1"].phase == "refused"
    await asyncio.sleep(0.05)
    assert len(client._orders._open) == 0

    bus.misbehave["mav1"] = "silent"
    orders = [await client.submit("hold mav1") for _ in range(5)]
    for order in orders:
        assert (await order.wait(5.0))["mav1"].phase == "no answer"
    await asyncio.sleep(0.05)
    assert len(client._orders._open) == 3


async def test_a_landing_that_takes_its_time_is_left_to_its_agent(
    fleet: FleetConfig, bus: Any
) -> None:
    bus.misbehave["mav1"] = "stuck"
    client = FleetClient(fleet, bus=bus, send=_never)
    await client.start()
    handle = await client.submit("land mav1")
    for _ in range(100):
        bus.tell("mav1", is_armed=True, is_airborne=True, autopilot_age_s=0.02)
        await asyncio.sleep(0.02)
    assert handle.results["mav1"].phase == "accepted"
    await client.stop()


async def test_what_an_agent_that_comes_back_says_does_not_end_an_order_that_went_straight_to_px4(
    fleet: FleetConfig, bus: Any
) -> None:
    async def send(_: DirectCommand) -> DirectResult:
        await asyncio.sleep(0.4)
        return DirectResult(True, True, "PX4 accepted it, and it is disarmed")

    bus.misbehave["mav1"] = "silent"
    client = FleetClient(fleet, bus=bus, send=send)
    await client.start()
    handle = await client.submit("land mav1")
    went = asyncio.Event()
    handle.add_listener(lambda result: went.set())
    await went.wait()
    assert handle.results["mav1"].phase == "direct"
    late = Event(
        vehicle="mav1",
        stamp_ns=1,
        severity="warning",
        code="order-land",
        sentence="Loop stalled for long: PX4 lands.",
        order_id=handle.planned.orders["mav1"].order_id,
        order_outcome="failed",
    )
    bus.on_message[Topic.EVENT](Topic.EVENT, "mav1", late)
    results = await handle.wait(5.0)
    await client.stop()
    assert results["mav1"].is_done
    assert "straight to PX4" in results["mav1"].sentence


@pytest.mark.parametrize("verb", ["land", "kill"])
async def test_accepted_without_a_heartbeat_that_shows_it_is_not_done(
    fleet: FleetConfig, bus: Any, verb: str
) -> None:
    async def send(_: DirectCommand) -> DirectResult:
        return DirectResult(True, False, "PX4 accepted it")

    bus.misbehave["mav1"] = "silent"
    client = FleetClient(fleet, bus=bus, send=send)
    await client.start()
    results = await client.order(f"{verb} mav1", 5.0)
    await client.stop()
    assert results["mav1"].phase == "failed"


async def test_without_a_direct_endpoint_the_silence_is_told_with_what_to_do(
    fleet: FleetConfig, bus: Any
) -> None:
    vehicles = {
        name: msgspec.structs.replace(vehicle, direct=None)
        for name, vehicle in fleet.vehicles.items()
    }
    bus.misbehave["mav1"] = "silent"
    client = FleetClient(msgspec.structs.replace(fleet, vehicles=vehicles), bus=bus)
    await client.start()
    result = (await client.order("land mav1", 5.0))["mav1"]
    await client.stop()
    assert result.phase == "no answer"
    assert "no direct endpoint" in result.sentence


async def test_a_flood_of_events_is_folded_and_stays_bounded(client: Any, bus: Any) -> None:
    for stamp_ns in range(10_000):
        event = Event(
            vehicle="mav0", stamp_ns=stamp_ns, severity="info", code="x", sentence="again"
        )
        bus.on_message[Topic.EVENT](Topic.EVENT, "mav0", event)
    assert await client.wait_for(lambda state: len(state.events) == 500, 5.0)


def test_the_direct_way_sends_mavlink_and_says_when_nobody_answers() -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
        result = send_direct(f"udpout://127.0.0.1:{port}", 1, "kill", timeout_s=0.3)
        first, _ = probe.recvfrom(2048)
    assert not result.is_accepted
    assert "did not answer" in result.sentence
    assert first[0] in (0xFD, 0xFE)
    assert mavutil_address("udpout://127.0.0.1:18570") == "udpout:127.0.0.1:18570"
    assert "cannot be opened" in send_direct("carrier-pigeon://x", 1, "land").sentence
