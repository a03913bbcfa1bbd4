"""Certificates that end: nothing begins that they do not outlast, and no flight is cut off."""

from __future__ import annotations

import asyncio
import datetime
import re
import shutil
import socket
import time
from pathlib import Path

import pytest
from msgspec.structs import replace

from groundstation.cli import main
from groundstation.client.preflight_page import _ground_key_lines
from groundstation.keys.authority import NODE_DAYS, issue, load_authority
from groundstation.keys.secured_fleet import secure_fleet
from onboard.agent.loop import AgentProcess
from onboard.agent_inputs import ShutdownRequested
from onboard.bus.codec import encode
from onboard.bus.schema import Order
from onboard.bus.session import BusSession
from onboard.bus.topics import Topic
from onboard.config.fleet import ConfigError, FleetConfig, load_fleet
from onboard.security.certificate_ends import first_end
from onboard.security.certificate_times import (
    end_words,
    left_words,
    longest_required_validity_s,
    required_validity_s,
)
from onboard.security.credentials import credentials_of
from onboard.security.order_signature import OrderSigner, SealCheck
from tests.onboard.bus.sessions import started, until
from tests.onboard.state_messages import state_message

PAPER = Path(__file__).parents[3] / "configs" / "fleets" / "paper.toml"
NOW = datetime.datetime.now(datetime.UTC)
KEY = "covey/paper/order/mav1"


@pytest.fixture
def fleet(tmp_path: Path) -> FleetConfig:
    """The paper's fleet with keys."""
    file = tmp_path / "fleet.toml"
    shutil.copy(PAPER, file)
    return _on_free_port(secure_fleet(str(file), NOW))


def _on_free_port(fleet: FleetConfig) -> FleetConfig:
    """Return a fleet whose agent of mav0 listens at a free port."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    agent = replace(fleet.vehicles["mav0"], agent=f"quic/127.0.0.1:{port}")
    return replace(fleet, vehicles={**fleet.vehicles, "mav0": agent})


def _issue_that_ends(fleet: FleetConfig, node: str, end: datetime.datetime) -> None:
    folder = Path(fleet.keys_folder)
    begin = end - datetime.timedelta(days=NODE_DAYS)
    issue(folder, load_authority(fleet), node, ["127.0.0.1"], begin)


def _session(fleet: FleetConfig, holder: str, *, listens: bool = False) -> BusSession:
    endpoint = fleet.vehicles["mav0"].agent
    return BusSession(
        namespace=fleet.namespace,
        node=holder,
        listen=[endpoint] if listens else [],
        connect=[] if listens else [endpoint],
        # checked as of earlier: what is tried here is the bus itself
        credentials=credentials_of(fleet, holder, NOW - datetime.timedelta(hours=1)),
    )


def test_an_open_link_outlasts_its_certificate_and_no_new_one_is_opened_with_it(
    fleet: FleetConfig,
) -> None:
    end = datetime.datetime.now(datetime.UTC) + datetime.timedelta(seconds=4)
    for node in ("mav0", "mav1"):
        _issue_that_ends(fleet, node, end)
    heard: list[str] = []

    with started(_session(fleet, "mav0", listens=True)) as agent:
        agent.subscribe(Topic.STATE, "*", lambda topic, name, message: heard.append(name))
        with started(_session(fleet, "mav1")) as other:

            def arrives() -> bool:
                other.publish(Topic.STATE, "mav1", state_message())
                return bool(heard)

            assert until(arrives)
            while datetime.datetime.now(datetime.UTC) < end + datetime.timedelta(seconds=2):
                time.sleep(0.1)
            heard.clear()
            assert until(arrives)

    _issue_that_ends(fleet, "mav0", NOW + datetime.timedelta(days=9))
    fleet = _on_free_port(fleet)
    heard.clear()
    with (
        started(_session(fleet, "mav0", listens=True)) as agent,
        started(_session(fleet, "mav1")) as late,
        started(_session(fleet, "mav2")) as other,
    ):
        agent.subscribe(Topic.STATE, "*", lambda topic, name, message: heard.append(name))

        def both_publish() -> bool:
            late.publish(Topic.STATE, "mav1", state_message())
            other.publish(Topic.STATE, "mav2", state_message())
            return len(heard) > 20

        assert until(both_publish)
        assert set(heard) == {"mav2"}


def test_a_ground_whose_certificate_has_ended_orders_who_flies_and_begins_no_flight(
    fleet: FleetConfig,
) -> None:
    _issue_that_ends(fleet, "ground", NOW - datetime.timedelta(hours=1))
    folder = fleet.keys_folder
    signer = OrderSigner(f"{folder}/ground.pem", f"{folder}/ground.key")

    def code(kind: str, now: datetime.datetime) -> str:
        check = SealCheck(f"{folder}/ca.pem", grace_s=7200.0)
        order = Order(
            order_id="g-1",
            author="ann",
            kind=kind,  # type: ignore[arg-type]
            stamp_ns=1,
            deadline_ns=2,
            node="g",
        )
        found = check.refusal(KEY, encode(order), signer.seal(KEY, encode(order)), now)
        return "" if found is None else found.code

    for kind in ("land", "hold", "kill", "move"):
        assert code(kind, NOW) == ""
        assert code(kind, NOW + datetime.timedelta(hours=1, minutes=1)) == "foreign"
    for kind in ("arm", "takeoff"):
        assert code(kind, NOW) == "foreign"
        assert code(kind, NOW - datetime.timedelta(hours=1, minutes=1)) == ""


def test_the_first_certificate_of_this_computer_that_ends_is_found(fleet: FleetConfig) -> None:
    for node, hours in (("mav1", 9.0), ("mav2", 5.0), ("viewer", 7.0)):
        _issue_that_ends(fleet, node, NOW + datetime.timedelta(hours=hours))
    found = first_end(fleet, "mav1")
    assert found is not None
    assert found.node == "mav2"
    assert found.left_s(NOW.timestamp()) == pytest.approx(5 * 3600, abs=2)

    Path(fleet.keys_folder, "mav2.key").unlink()  # mav2 runs on another computer
    found = first_end(fleet, "mav1")
    assert found is not None
    assert found.node == "viewer"
    assert first_end(load_fleet(PAPER), "mav1") is None


def test_a_flight_takes_the_hover_time_and_an_hour_or_two_hours() -> None:
    vehicle = load_fleet(PAPER).vehicles["mav0"]
    assert required_validity_s(replace(vehicle, hover_time_s=600.0)) == 4200.0
    assert required_validity_s(replace(vehicle, hover_time_s=None)) == 7200.0


def test_less_than_two_days_are_said_in_hours(
    fleet: FleetConfig, capsys: pytest.CaptureFixture[str]
) -> None:
    end = NOW + datetime.timedelta(hours=47)
    assert end_words(end, NOW) == f"{end:%Y-%m-%d %H:%M} UTC, 47.0 h from now"
    assert end_words(NOW + datetime.timedelta(hours=49), NOW).count("-") == 2
    assert left_words(240.0) == "0.1 h"

    # the clock goes on between here and there: to the hour only
    _issue_that_ends(fleet, "mav1", NOW + datetime.timedelta(hours=4.9))
    assert main(["keys", "list", fleet.path]) == 0
    lines = capsys.readouterr().out.splitlines()
    (line,) = [line for line in lines if line.startswith("mav1")]
    assert re.search(r"UTC, 4\.\d h from now", line)

    main(["doctor", fleet.path])
    assert "mav1's" in (page := capsys.readouterr().out)
    assert re.search(r"4\.\d h from now", " ".join(page.split()))


def test_the_ground_s_own_certificate_has_a_line_on_the_preflight_page(fleet: FleetConfig) -> None:
    assert _ground_key_lines(fleet) == []


@pytest.mark.parametrize(("hours", "status"), [(0.5, "no-go"), (5.0, "advice"), (-1.0, "no-go")])
def test_a_ground_whose_certificate_ends_soon_is_no_go_or_gets_advice(
    fleet: FleetConfig, hours: float, status: str
) -> None:
    _issue_that_ends(fleet, "ground", NOW + datetime.timedelta(hours=hours))
    (line,) = _ground_key_lines(fleet)
    assert line.status == status
    assert "has ended" in line.sentence or " h" in line.sentence


def test_an_agent_on_the_ground_ends_its_links_one_flight_and_an_hour_after_the_end(
    fleet: FleetConfig,
) -> None:
    agent = AgentProcess(fleet, "mav0", apply_params=False)
    end = first_end(fleet, "mav0")
    assert end is not None
    left_s = end.left_s(time.time()) + longest_required_validity_s(fleet)
    for over_s, ends in ((-60.0, False), (60.0, True)):
        now_ns = time.monotonic_ns() + round((left_s + over_s) * 1e9)
        for _ in range(2):
            agent._check_certificate(now_ns)
        assert _requests_to_end(agent) == int(ends)


def _requests_to_end(agent: AgentProcess) -> int:
    return sum(isinstance(notice, ShutdownRequested) for notice in agent._inbox.notices)


def test_a_time_of_day_that_jumps_far_ahead_does_not_end_an_agent(
    fleet: FleetConfig, monkeypatch: pytest.MonkeyPatch
) -> None:
    agent = AgentProcess(fleet, "mav0", apply_params=False)
    years_ahead_s = time.time() + 1e9
    monkeypatch.setattr("onboard.agent.loop.time.time", lambda: years_ahead_s)
    agent._check_certificate(time.monotonic_ns())
    assert _requests_to_end(agent) == 0


@pytest.mark.parametrize(("after_s", "status"), [(0.0, 0), (1e9, 1)])
async def test_an_agent_whose_certificate_has_ended_ends_with_status_1(
    fleet: FleetConfig, after_s: float, status: int
) -> None:
    agent = AgentProcess(fleet, "mav0", apply_params=False)
    agent._ended = asyncio.get_running_loop().create_future()
    agent._check_certificate(time.monotonic_ns() + round(after_s * 1e9))
    agent._exit()
    assert await agent._ended == status


def test_nobody_starts_with_a_certificate_that_has_ended(fleet: FleetConfig) -> None:
    _issue_that_ends(fleet, "mav1", NOW - datetime.timedelta(minutes=1))
    with pytest.raises(ConfigError, match="has expired on"):
        credentials_of(fleet, "mav1")
