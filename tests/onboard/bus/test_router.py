"""Behind routers: who may say what, who is told what, and what goes on when a router dies."""

from __future__ import annotations

import datetime
import functools
import itertools
import shutil
import signal
import socket
import subprocess
import sys
import time
import tomllib
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path

import pytest
from msgspec.structs import replace

from groundstation.cli import main
from groundstation.keys.secured_fleet import secure_fleet
from onboard.bus.protocol import NoRouterError, UntrustedOrder
from onboard.bus.router import Router, router_endpoint, router_settings
from onboard.bus.schema import MocapPose, MocapPoses, Order, OrderReply
from onboard.bus.session import BusSession
from onboard.bus.topics import Topic
from onboard.bus.zenoh_settings import Setting
from onboard.config.fleet import ConfigError, FleetConfig, fleet_from_mapping, load_fleet
from onboard.security.credentials import credentials_of, router_credentials
from tests.onboard.bus.sessions import started, until
from tests.onboard.state_messages import state_message

PAPER = Path(__file__).parents[3] / "configs" / "fleets" / "paper.toml"
NOW = datetime.datetime.now(datetime.UTC)
NAMES = {"ground": "ground-1-a", "viewer": "watcher-1-a"}
LAND = Order(
    order_id="g-1", author="ann", kind="land", stamp_ns=1, deadline_ns=0, node="ground-1-a"
)
POSE = MocapPose(
    body="mav1", boot_id=1, sequence=1, stamp_ns=1, is_tracked=True, position_enu_m=(0.0, 0.0, 1.0),
    quaternion_enu_flu_wxyz=(1.0, 0.0, 0.0, 0.0),
)  # fmt: skip


def _free_ports(count: int) -> list[int]:
    with ExitStack() as stack:
        probes = [
            stack.enter_context(socket.socket(socket.AF_INET, socket.SOCK_DGRAM))
            for _ in range(count)
        ]
        for probe in probes:
            probe.bind(("127.0.0.1", 0))
        return [probe.getsockname()[1] for probe in probes]


def _fleet(
    folder: Path, *, routers: int = 1, name: str = "paper", has_keys: bool = True
) -> FleetConfig:
    endpoints = ", ".join(f'"tcp/127.0.0.1:{port}"' for port in _free_ports(routers))
    text = PAPER.read_text(encoding="utf-8").replace(
        'name = "paper"', f'name = "{name}"\nrouters = [{endpoints}]'
    )
    folder.mkdir(exist_ok=True)
    (folder / "fleet.toml").write_text(text, encoding="utf-8")
    file = str(folder / "fleet.toml")
    return secure_fleet(file, NOW) if has_keys else load_fleet(file)


def _settings(fleets: Sequence[FleetConfig], endpoint: str | None = None) -> list[Setting]:
    own_endpoint = router_endpoint(fleets, endpoint)
    return router_settings(fleets, own_endpoint, router_credentials(fleets))


@contextmanager
def _routing(*fleets: FleetConfig) -> Iterator[None]:
    router = Router(_settings(fleets))
    router.start()
    try:
        yield
    finally:
        router.stop()


@contextmanager
def _node(fleet: FleetConfig, holder: str) -> Iterator[BusSession]:
    credentials = credentials_of(fleet, holder)
    name = NAMES.get(holder, holder)
    routers = fleet.fleet.routers
    with started(
        BusSession(namespace=fleet.namespace, node=name, credentials=credentials, routers=routers)
    ) as session:
        yield session


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> FleetConfig:
    """A fleet with keys and one router."""
    return _fleet(tmp_path_factory.mktemp("fleets") / "locked")


@pytest.fixture
def locked(made: FleetConfig) -> FleetConfig:
    """The same with the router on a free port."""
    (port,) = _free_ports(1)
    return replace(made, fleet=replace(made.fleet, routers=(f"quic/127.0.0.1:{port}",)))


def test_a_router_holds_each_node_to_its_role_and_orders_stay_signed(locked: FleetConfig) -> None:
    heard: set[tuple[Topic, str]] = set()
    alive: set[str] = set()
    taken: list[Order | UntrustedOrder] = []
    answered: list[str] = []

    def answer(order: object, reply: Callable[[OrderReply], None]) -> None:
        assert isinstance(order, Order | UntrustedOrder)
        taken.append(order)
        reply(OrderReply(order_id=order.order_id, vehicle="mav0", is_accepted=True, reason=""))

    with _routing(locked), ExitStack() as stack:
        agent, twin, other, ground, viewer, mocap = (
            stack.enter_context(_node(locked, holder))
            for holder in ("mav0", "mav0", "mav1", "ground", "viewer", "mocap")
        )
        for topic in (Topic.STATE, Topic.SLOW_TELEMETRY, Topic.MOCAP, Topic.CLOCK):
            agent.subscribe(topic, "*", lambda topic, name, _: heard.add((topic, name)))
        agent.serve_orders("mav0", answer)
        agent.watch_alive(lambda name, is_alive: alive.add(name) if is_alive else None)
        viewer.claim("operator.1.x.y")
        granted = {(Topic.STATE, "mav1"), (Topic.SLOW_TELEMETRY, "mav0"), (Topic.MOCAP, "body")}
        message = state_message()

        def tell() -> bool:
            for false in (viewer, mocap, other):
                for topic in (Topic.STATE, Topic.SLOW_TELEMETRY, Topic.CLOCK):
                    false.publish(topic, "mav2", message)
            viewer.publish(Topic.MOCAP, "viewed", message)
            other.publish(Topic.MOCAP, "claimed", message)
            mocap.publish(Topic.MOCAP, "body", message)
            other.publish(Topic.STATE, "mav1", message)
            # a second agent of one name shows itself
            twin.publish(Topic.SLOW_TELEMETRY, "mav0", message)
            return heard >= granted

        assert until(tell), granted - heard
        for _ in range(5):
            tell()
            time.sleep(0.02)
        for sender in (viewer, other, ground):
            ended: list[bool] = []
            sender.order(
                "mav0",
                LAND,
                timeout_s=1.0,
                on_reply=lambda reply: (
                    answered.append(reply.vehicle) if isinstance(reply, OrderReply) else None
                ),
                on_end=functools.partial(ended.append, True),
            )
            assert until(functools.partial(bool, ended))
        assert heard == granted
        assert taken == [LAND]
        assert answered == ["mav0"]
        assert {"mav1", "mocap", "ground-1-a"} <= alive
        assert "operator.1.x.y" not in alive


def test_a_router_that_grants_everything_still_brings_no_false_order(locked: FleetConfig) -> None:
    taken: list[Order | UntrustedOrder] = []

    def answer(order: object, reply: Callable[[OrderReply], None]) -> None:
        assert isinstance(order, Order | UntrustedOrder)
        taken.append(order)
        reply(OrderReply(order_id=order.order_id, vehicle="mav0", is_accepted=False, reason=""))

    careless = Router(
        [setting for setting in _settings([locked]) if setting[0] != "access_control"]
    )
    careless.start()
    try:
        with _node(locked, "mav0") as agent, _node(locked, "viewer") as viewer:
            agent.serve_orders("mav0", answer)

            def order() -> bool:
                viewer.order(
                    "mav0", LAND, timeout_s=0.2, on_reply=lambda _: None, on_end=lambda: None
                )
                return bool(taken)

            assert until(order)
    finally:
        careless.stop()
    assert {one.code if isinstance(one, UntrustedOrder) else "" for one in taken} == {"role"}


def test_fleets_on_one_router_hear_nothing_of_each_other(tmp_path: Path) -> None:
    north = _fleet(tmp_path / "north", name="north", has_keys=False)
    data = tomllib.loads(north.text)
    south = fleet_from_mapping(
        {**data, "fleet": {**data["fleet"], "name": "south"}}, path=north.path
    )
    heard: list[str] = []
    with _routing(north, south), _node(north, "mav0") as hearer, _node(south, "mav1") as foreign:
        hearer.subscribe(Topic.STATE, "*", lambda _topic, name, _: heard.append(name))
        with _node(north, "mav2") as own:

            def tell() -> bool:
                foreign.publish(Topic.STATE, "mav1", state_message())
                own.publish(Topic.STATE, "mav2", state_message())
                return len(heard) > 5

            assert until(tell)
    assert set(heard) == {"mav2"}


@contextmanager
def _process(fleet: FleetConfig, number: int) -> Iterator[subprocess.Popen[str]]:
    command = [sys.executable, "-u", "-m", "groundstation", "router", fleet.path]
    process = subprocess.Popen(
        [*command, "--endpoint", fleet.fleet.routers[number]], stdout=subprocess.PIPE, text=True
    )
    try:
        assert process.stdout is not None
        assert process.stdout.readline().startswith("router: ")
        yield process
    finally:
        process.kill()
        process.wait()


def test_another_router_takes_over_and_a_hung_client_holds_up_nobody(tmp_path: Path) -> None:
    fleet = _fleet(tmp_path / "two", routers=2)
    # on the other site
    far = replace(fleet, fleet=replace(fleet.fleet, routers=fleet.fleet.routers[::-1]))
    heard: list[float] = []
    alive: dict[str, bool] = {}
    hung = f"""
import sys, time
from onboard.security.credentials import credentials_of
from onboard.bus.session import BusSession
from onboard.bus.topics import Topic
from onboard.config.fleet import load_fleet
fleet = load_fleet({fleet.path!r})
node = BusSession(namespace=fleet.namespace, node="mav2", credentials=credentials_of(fleet, "mav2"),
                  routers=fleet.fleet.routers)
node.start()
node.subscribe(Topic.STATE, "*", lambda *_: None)
print("up", flush=True)
time.sleep(60)
"""
    with (
        _process(fleet, 0) as first,
        _process(fleet, 1),
        _node(fleet, "mav0") as agent,
        _node(far, "ground") as ground,
    ):
        ground.subscribe(Topic.STATE, "mav0", lambda *_: heard.append(time.monotonic()))
        ground.watch_alive(alive.__setitem__)

        def tell() -> None:
            agent.publish(Topic.STATE, "mav0", state_message())

        def longest_gap_s(seconds: float) -> float:
            begin_s = time.monotonic()
            count = len(heard)

            def is_over() -> bool:
                tell()
                return time.monotonic() - begin_s > seconds

            until(is_over, seconds + 1.0)
            times = [begin_s, *heard[count:], time.monotonic()]
            return max(later - earlier for earlier, later in itertools.pairwise(times))

        def arrived(least: int) -> bool:
            tell()
            return len(heard) > least

        assert until(lambda: arrived(0))  # from one router to the other
        with subprocess.Popen(
            [sys.executable, "-c", hung], stdout=subprocess.PIPE, text=True
        ) as peer:
            try:
                assert peer.stdout is not None
                assert peer.stdout.readline() == "up\n"
                joined_s = time.monotonic()
                assert until(lambda: alive.get("mav2"), 2.0)  # a late joiner
                assert time.monotonic() - joined_s < 2.0
                peer.send_signal(signal.SIGSTOP)
                assert longest_gap_s(1.0) < 0.5
            finally:
                peer.kill()
        assert until(lambda: alive.get("mav2") is False)
        first.kill()
        assert first.wait() == -signal.SIGKILL
        count = len(heard)
        assert until(lambda: arrived(count + 20))
        assert until(lambda: alive.get("mav0"))


@pytest.mark.parametrize("source", ["printed", "written in the docs"])
def test_a_router_without_a_line_of_covey_serves_a_fleet(
    locked: FleetConfig, source: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    if source == "printed":
        assert main(["router", locked.path, "--print-config"]) == 0
        written = load_fleet(locked.path).fleet.routers[0]
        text = capsys.readouterr().out.replace(written, locked.fleet.routers[0])
    else:
        page = (PAPER.parents[2] / "docs" / "network.md").read_text(encoding="utf-8")
        text = page.partition("<!-- zenohd -->")[2].partition("```json5\n")[2].partition("```")[0]
        text = text.replace("quic/10.0.0.5:7447", locked.fleet.routers[0]).replace(
            '"keys/', f'"{locked.keys_folder}/'
        )
    (tmp_path / "router.json5").write_text(text, encoding="utf-8")
    bare = "import sys, time, zenoh; s = zenoh.open(zenoh.Config.from_file(sys.argv[1])); "
    bare += "print('up', flush=True)"
    heard: set[str] = set()
    alive: set[str] = set()
    answered: list[str] = []
    with ExitStack() as stack:
        command = [sys.executable, "-c", f"{bare}; time.sleep(60)", str(tmp_path / "router.json5")]
        process = stack.enter_context(subprocess.Popen(command, stdout=subprocess.PIPE, text=True))
        stack.callback(process.kill)
        assert process.stdout is not None
        assert process.stdout.readline() == "up\n"
        first, second, ground = (
            stack.enter_context(_node(locked, holder)) for holder in ("mav0", "mav1", "ground")
        )
        first.subscribe(Topic.STATE, "*", lambda _topic, name, _: heard.add(name))
        ground.subscribe(
            Topic.STATE, "*", lambda _topic, name, _: heard.add(f"{name} on the ground")
        )
        ground.watch_alive(lambda name, _: alive.add(name))
        for topic in (Topic.MOCAP, Topic.ALL_POSES):
            first.subscribe(
                topic, "*", lambda topic, name, _: heard.add(f"{topic.value} of {name}")
            )
        second.serve_orders("mav1", lambda order, reply: reply(_accepted(order)))

        def tell() -> bool:
            second.publish(Topic.STATE, "mav2", state_message())  # in another's name
            # its own body's, which only the motion capture may
            second.publish(Topic.MOCAP, "mav1", POSE)
            second.publish(Topic.ALL_POSES, "mav1", MocapPoses(poses=(POSE,)))
            second.publish(Topic.STATE, "mav1", state_message())
            first.publish(Topic.STATE, "mav0", state_message())
            return {"mav1", "mav0 on the ground", "mav1 on the ground"} <= heard and {
                "mav0",
                "mav1",
            } <= alive

        assert until(tell), (heard, alive)

        def order() -> bool:
            ground.order(
                "mav1",
                LAND,
                timeout_s=0.5,
                on_reply=lambda reply: answered.append(str(reply)),
                on_end=lambda: None,
            )
            return bool(answered)

        assert until(order)
    assert "is_accepted=True" in answered[0]
    assert heard == {"mav1", "mav0 on the ground", "mav1 on the ground"}


def _accepted(order: object) -> OrderReply:
    """Accept what is believed."""
    return OrderReply(
        order_id="g-1", vehicle="mav1", is_accepted=isinstance(order, Order), reason=""
    )


def test_what_cannot_be_a_router_is_refused_in_a_sentence(
    locked: FleetConfig, tmp_path: Path
) -> None:
    with pytest.raises(NoRouterError, match="No router of this fleet answers at quic/"):
        BusSession(
            namespace=locked.namespace,
            node="mav0",
            credentials=credentials_of(locked, "mav0"),
            routers=locked.fleet.routers,
            router_timeout_s=0.3,
        ).start()
    with pytest.raises(ConfigError, match="names no router"):
        _settings([load_fleet(PAPER)])
    away = replace(locked, fleet=replace(locked.fleet, routers=("quic/192.0.2.7:7447",)))
    with pytest.raises(ConfigError, match="is an address of this computer"):
        _settings([away])
    with pytest.raises(
        ConfigError,
        match=r"router.pem is for 127.0.0.1, but the fleet file has router at 192.0.2.7",
    ):
        _settings([away], "quic/192.0.2.7:7447")
    with pytest.raises(ConfigError, match="is no router of this fleet"):
        _settings([locked], "quic/127.0.0.1:1")
    two = _fleet(tmp_path / "two", routers=2)
    with pytest.raises(ConfigError, match="Choose one: --endpoint"):
        _settings([two])
    both = replace(two, fleet=replace(two.fleet, name="other", routers=locked.fleet.routers))
    with pytest.raises(ConfigError, match="have different authorities"):
        _settings([locked, both])
    with pytest.raises(ConfigError, match="both have a vehicle 'mav0'"):
        _settings([locked, replace(locked, fleet=replace(locked.fleet, name="other"))])
    copy = Path(shutil.copytree(Path(locked.path).parent, tmp_path / "copy"))
    (copy / "keys" / "router.pem").unlink()
    with pytest.raises(ConfigError, match="is missing: a router cannot join"):
        _settings([load_fleet(copy / "fleet.toml")])


def test_a_router_at_the_endpoint_of_somebody_else_is_refused() -> None:
    data = tomllib.loads(PAPER.read_text(encoding="utf-8"))
    taken = data["vehicles"]["mav1"]["agent"]
    for routers, words in (
        ([taken], "Only one can listen there"),
        (["10.0.0.5"], "write it as quic/10.0.0.5:7447"),
    ):
        with pytest.raises(ConfigError, match=words):
            fleet_from_mapping({**data, "fleet": {**data["fleet"], "routers": routers}})


def test_only_a_fleet_with_routers_lets_a_router_in(locked: FleetConfig, tmp_path: Path) -> None:
    own = credentials_of(locked, "mav0")
    assert own is not None
    assert "'cert_common_names': ['router']" in str(own.access)
    shutil.copy(PAPER, tmp_path / "fleet.toml")
    without = credentials_of(secure_fleet(str(tmp_path / "fleet.toml"), NOW), "mav0")
    assert without is not None
    assert "router" not in str(without.access)
    assert not (tmp_path / "keys" / "router.pem").exists()
