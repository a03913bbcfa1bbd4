"""The page in a browser: what it shows and takes, and that only its own page gets in."""

from __future__ import annotations

import asyncio
import contextlib
import json
import re
import socket
from collections import Counter
from collections.abc import AsyncIterator, Callable
from datetime import datetime, timedelta
from pathlib import Path
from typing import Any, NamedTuple
from urllib.parse import urljoin, urlsplit

import aiohttp
import pytest
import pytest_asyncio

from groundstation.client.client import FleetClient
from groundstation.missions.runner import MissionRun
from groundstation.orders.forecast import Forecast
from groundstation.scene.ground_tiles import GroundTile, GroundTiles
from groundstation.web import live_feed, order_cards, page_server
from groundstation.web.live_feed import LiveFeed
from groundstation.web.page_server import PageServer, require_loopback
from onboard.bus.schema import Event
from onboard.bus.topics import Topic
from onboard.config.fleet import ConfigError, FleetConfig
from tests.groundstation.conftest import FakeBus
from tests.groundstation.console.scenes import SteadyClient, crowd

_LINK = re.compile(r"""(?:href|src)\s*=\s*["']([^"']*)["']|url\(\s*["']?([^"')]*)""")

Message = dict[str, Any]


class Served(NamedTuple):
    """A page's server, its address, and the fleet behind it."""

    server: PageServer
    address: str
    bus: Any
    feed: LiveFeed


class Calm:
    """A forecast at once, in which nobody comes near anybody."""

    async def forecast(self, *_: Any, **__: Any) -> Forecast:
        return Forecast(closest_m=1.5, pair=("mav0", "mav1"), now_m=1.5, duration_s=4.0)

    async def stop(self) -> None:
        return


async def serve(
    fleet: FleetConfig, *, can_order: bool, key: str = "", ground: GroundTiles | None = None
) -> AsyncIterator[Served]:
    bus: Any = FakeBus(fleet, has_truth=True)
    client = FleetClient(fleet, author="ada", operates=can_order, bus=bus)
    forecaster: Any = Calm()
    feed = LiveFeed(fleet, client, can_order=can_order, forecaster=forecaster, ground=ground)
    server = PageServer(title='a <b>"fleet"', feed=feed, ground=ground, key=key)
    address = await server.start("127.0.0.1", 0)
    await feed.start()
    beat = asyncio.create_task(bus.beat())
    try:
        yield Served(server, address, bus, feed)
    finally:
        beat.cancel()
        await server.stop()
        await feed.stop()


@pytest_asyncio.fixture
async def operated(fleet: FleetConfig) -> AsyncIterator[Served]:
    async for served in serve(fleet, can_order=True):
        yield served


@pytest_asyncio.fixture
async def watched(fleet: FleetConfig) -> AsyncIterator[Served]:
    async for served in serve(fleet, can_order=False):
        yield served


@contextlib.asynccontextmanager
async def opened(served: Served) -> AsyncIterator[aiohttp.ClientWebSocketResponse]:
    """The socket of a page."""
    async with (
        aiohttp.ClientSession() as session,
        session.ws_connect(served.address + "ws") as socket,
    ):
        yield socket


async def heard(
    socket: aiohttp.ClientWebSocketResponse, wanted: Callable[[Message], object]
) -> Message:
    """The first message of a socket that is wanted."""
    async with asyncio.timeout(15.0):
        while True:
            message: Message = json.loads((await socket.receive()).data)
            if wanted(message):
                return message


def card(text: str, phase: str) -> Callable[[Message], bool]:
    def wanted(message: Message) -> bool:
        return (message.get("text"), message.get("phase")) == (text, phase)

    return wanted


def is_operator(message: Message) -> bool:
    return message["kind"] == "state" and message["control"]["refusal"] is None


async def test_everything_that_the_page_loads_comes_from_this_server(watched: Served) -> None:
    address = watched.address
    seen: set[str] = set()
    todo = [address]
    async with aiohttp.ClientSession() as session:
        while todo:
            url = todo.pop()
            async with session.get(url) as response:
                assert response.status == 200, url
                assert "default-src 'none'" in response.headers["Content-Security-Policy"]
                body = (await response.read()).decode()
                if not response.content_type.startswith(("text/html", "text/css")):
                    continue
            for groups in _LINK.findall(body):
                link = next((group for group in groups if group), "")
                target = urljoin(url, link)
                assert urlsplit(target).netloc == urlsplit(address).netloc, target
                if target not in seen:
                    seen.add(target)
                    todo.append(target)
        async with session.get(address) as response:
            text = await response.text()
    assert "a &lt;b&gt;&quot;fleet&quot;" in text
    assert any(name.endswith("live.js") for name in seen)
    assert any(name.endswith("scene.js") for name in seen)


@pytest.mark.parametrize(
    "name", ["files/../page_server.py", "files/static_files.py", "files/", "x"]
)
async def test_no_other_file_is_served(watched: Served, name: str) -> None:
    async with aiohttp.ClientSession() as session, session.get(watched.address + name) as response:
        assert response.status == 404


async def test_a_page_gets_the_fleet_then_its_state_again_and_again(watched: Served) -> None:
    async with opened(watched) as socket:
        fleet = await heard(socket, lambda message: True)
        assert fleet["kind"] == "fleet"
        assert fleet["vehicles"] == ["mav0", "mav1", "mav2"]
        assert not fleet["can_order"]
        state = await heard(socket, lambda m: m["kind"] == "state" and m["vehicles"][0]["is_fresh"])
        assert state["vehicles"][1]["position_enu_m"] == [0.0, -1.5, 0.0]
        assert state["control"] is None
        later = await heard(socket, lambda m: m["kind"] == "state")
        assert later["time_s"] > state["time_s"]


async def test_whoever_makes_a_page_that_only_watches_say_something_is_not_heard(
    watched: Served,
) -> None:
    async with opened(watched) as socket:
        await socket.send_str(json.dumps({"do": "urgent", "verb": "land"}))
        await socket.send_str(json.dumps({"do": "order", "text": "kill mav0"}))
        await heard(socket, lambda m: m["kind"] == "state")
        await heard(socket, lambda m: m["kind"] == "state")
    assert watched.bus.orders == []


async def test_what_could_go_wrong_is_shown_first_and_sent_by_its_confirmation(
    operated: Served,
) -> None:
    async with opened(operated) as socket:
        await heard(socket, is_operator)
        await socket.send_str(json.dumps({"do": "order", "text": "takeoff all 1.0"}))
        shown = await heard(
            socket, lambda m: card("takeoff all 1.0", "previewed")(m) and m.get("can_send")
        )
        assert any("closest: 1.50 m" in figure for figure in shown["figures"])
        assert operated.bus.orders == []
        await socket.send_str(json.dumps({"do": "confirm", "number": shown["number"]}))
        done = await heard(
            socket, lambda m: card("takeoff all 1.0", "sent")(m) and m.get("is_final")
        )
        assert {result["phase"] for result in done["results"]} == {"done"}
    assert [order.kind for _, order in operated.bus.orders] == ["takeoff"] * 3


async def confirmed(socket: aiohttp.ClientWebSocketResponse, text: str) -> Message:
    """Order a line, confirm its card, and return the card as it was shown."""
    await socket.send_str(json.dumps({"do": "order", "text": text}))

    def can_send(message: Message) -> bool:
        return card(text, "previewed")(message) and bool(message.get("can_send"))

    shown = await heard(socket, can_send)
    await asyncio.sleep(0.3)  # nothing is sent in the first moment after it was shown
    await socket.send_str(json.dumps({"do": "confirm", "number": shown["number"]}))
    return shown


async def test_a_take_off_in_waves_is_flown_wave_after_wave_and_its_card_has_the_verdict(
    operated: Served,
) -> None:
    async with opened(operated) as socket:
        await heard(socket, is_operator)
        text = "takeoff all 1.0 by 2 every 0.1"
        await confirmed(socket, text)
        ended = await heard(socket, lambda m: card(text, "sent")(m) and m["outcome"])
        assert ended["outcome"] == "passed", ended["sentences"]
    ordered = [(name, order.kind) for name, order in operated.bus.orders]
    assert ordered == [("mav0", "takeoff"), ("mav1", "takeoff"), ("mav2", "takeoff")]
    times_ns = [order.stamp_ns for _, order in operated.bus.orders]
    assert times_ns[2] - times_ns[1] > 0.1e9


async def test_a_mission_that_breaks_off_says_so_on_its_card_and_the_page_lives_on(
    operated: Served, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def break_off(_: MissionRun) -> None:
        raise ZeroDivisionError("a mistake")

    monkeypatch.setattr(MissionRun, "run", break_off)
    async with opened(operated) as socket:
        await heard(socket, is_operator)
        text = "takeoff all 1.0 by 2 every 0.1"
        await confirmed(socket, text)
        ended = await heard(socket, lambda m: card(text, "sent")(m) and m["outcome"])
        assert ended["outcome"] == "failed"
        assert ended["sentences"][0] == "The mission broke off: ZeroDivisionError: a mistake"

        await socket.send_str(json.dumps({"do": "urgent", "verb": "land"}))
        assert await heard(socket, card("land all", "sent"))


async def test_a_mission_under_way_is_no_failed_one_on_a_page_that_is_loaded_again(
    operated: Served, monkeypatch: pytest.MonkeyPatch
) -> None:
    goes_on = asyncio.Event()

    async def fly(_: MissionRun) -> None:
        await goes_on.wait()

    monkeypatch.setattr(MissionRun, "run", fly)
    text = "takeoff all 1.0 by 2 every 0.1"
    async with opened(operated) as socket:
        await heard(socket, is_operator)
        await confirmed(socket, text)
        await heard(socket, card(text, "sent"))
    async with opened(operated) as socket:
        again = await heard(socket, card(text, "sent"))
        assert not again["outcome"]
        goes_on.set()
        ended = await heard(socket, lambda m: card(text, "sent")(m) and m["outcome"])
        assert ended["outcome"] == "failed"


async def test_a_countdown_is_asked_about_shown_and_stopped(
    operated: Served, tmp_path: Path
) -> None:
    mission = tmp_path / "hop.toml"
    mission.write_text('schema = 1\n[[step]]\ndo = "takeoff"\nheight_m = 1.0\n')
    at = (datetime.now().astimezone() + timedelta(minutes=5)).isoformat(timespec="seconds")
    async with opened(operated) as socket:
        await heard(socket, is_operator)
        shown = await confirmed(socket, f"mission {mission} at {at}")
        assert "Begins in " in shown["figures"][0]

        def counts_down(message: Message) -> bool:
            return message["kind"] == "state" and message["mission"]["counts_down"]

        counting = await heard(socket, counts_down)
        assert "starts at" in counting["mission"]["line"]
        await socket.send_str(json.dumps({"do": "stop_countdown"}))
        ended = await heard(socket, lambda m: m["kind"] == "card" and m["outcome"])
        assert ended["outcome"] == "failed"
        assert "stopped the countdown" in " ".join(ended["sentences"])
    assert operated.bus.orders == []


async def test_a_countdown_is_not_begun_while_another_mission_flies(
    operated: Served, tmp_path: Path
) -> None:
    hop = tmp_path / "hop.toml"
    hop.write_text('schema = 1\n[[step]]\ndo = "takeoff"\nheight_m = 1.0\n')
    wait = tmp_path / "wait.toml"
    wait.write_text('schema = 1\n[[step]]\ndo = "wait"\nduration_s = 60.0\n')
    at = (datetime.now().astimezone() + timedelta(minutes=5)).isoformat(timespec="seconds")
    later = f"mission {hop} at {at}"
    async with opened(operated) as socket:
        await heard(socket, is_operator)
        await socket.send_str(json.dumps({"do": "order", "text": later}))
        waiting = await heard(socket, card(later, "previewed"))
        await socket.send_str(json.dumps({"do": "order", "text": f"mission {wait}"}))
        await heard(socket, card(f"mission {wait}", "sent"))
        await socket.send_str(json.dumps({"do": "confirm", "number": waiting["number"]}))
        await socket.send_str(json.dumps({"do": "drop", "number": waiting["number"]}))
        shown = await heard(socket, lambda m: m.get("text") == later and not m["can_send"])
        assert shown["phase"] == "previewed"
        assert shown["reasons"] == ["A mission flies already. Write: stop"]
        await heard(socket, card(later, "dropped"))


async def test_vehicles_out_of_service_and_their_spares_say_so(operated: Served) -> None:
    operated.bus.tell("mav1", disabled_by="olga")
    operated.bus.tell("mav2", stands_in_for="mav1")

    def tells_service(message: Message) -> bool:
        if message["kind"] != "state":
            return False
        service = {one["name"]: one.get("service") for one in message["vehicles"]}
        return service == {"mav0": "", "mav1": "disabled by olga", "mav2": "stands in for mav1"}

    async with opened(operated) as socket:
        await heard(socket, tells_service)
        for text in ("disable mav0", "enable mav0", "reboot mav0"):
            await socket.send_str(json.dumps({"do": "order", "text": text}))
            await heard(socket, card(text, "sent"))
    assert [order.kind for _, order in operated.bus.orders] == ["disable", "enable", "reboot"]


async def test_a_page_that_is_loaded_again_shows_the_cards_of_before(operated: Served) -> None:
    async with opened(operated) as socket:
        await heard(socket, is_operator)
        await socket.send_str(json.dumps({"do": "order", "text": "takeoff mav0 1.0"}))
        await heard(socket, card("takeoff mav0 1.0", "previewed"))
    async with opened(operated) as socket:
        again = await heard(socket, card("takeoff mav0 1.0", "previewed"))
        await socket.send_str(json.dumps({"do": "drop", "number": again["number"]}))
        await heard(socket, card("takeoff mav0 1.0", "dropped"))
    assert operated.bus.orders == []


async def test_land_all_goes_out_at_once_and_drops_whatever_waits(operated: Served) -> None:
    async with opened(operated) as socket:
        await heard(socket, is_operator)
        await socket.send_str(json.dumps({"do": "order", "text": "takeoff all 1.0"}))
        await heard(socket, card("takeoff all 1.0", "previewed"))
        await socket.send_str(json.dumps({"do": "urgent", "verb": "land"}))
        dropped = await heard(socket, card("takeoff all 1.0", "dropped"))
        assert dropped["sentences"] == ["LAND ALL came first."]
        await heard(socket, card("land all", "sent"))
    assert [order.kind for _, order in operated.bus.orders] == ["land"] * 3


async def test_a_kill_needs_the_same_words_twice_within_a_second(operated: Served) -> None:
    async with opened(operated) as socket:
        await heard(socket, is_operator)
        await socket.send_str(json.dumps({"do": "order", "text": "kill mav1"}))
        armed = await heard(socket, card("kill mav1", "refused"))
        assert "Again within 1 s" in armed["sentences"][0]
        assert operated.bus.orders == []
        await socket.send_str(json.dumps({"do": "order", "text": "kill mav1"}))
        await heard(socket, card("kill mav1", "sent"))
        assert [(name, order.kind) for name, order in operated.bus.orders] == [("mav1", "kill")]
        await socket.send_str(json.dumps({"do": "order", "text": "takeoff mav1 1"}))
        refused = await heard(socket, card("takeoff mav1 1", "refused"))
        assert "mav1 was killed" in refused["sentences"][0]
        await socket.send_str(json.dumps({"do": "order", "text": "reset mav0"}))
        await heard(socket, card("reset mav0", "answered"))
        await socket.send_str(json.dumps({"do": "order", "text": "takeoff mav1 2"}))
        await heard(socket, card("takeoff mav1 2", "refused"))
        await socket.send_str(json.dumps({"do": "order", "text": "reset mav1"}))
        freed = await heard(socket, card("reset mav1", "answered"))
        assert freed["sentences"] == ["mav1 may be ordered again."]


async def test_a_killed_vehicle_says_that_it_gets_no_orders_until_it_is_reset(
    operated: Served,
) -> None:
    sentence = "mav1 was killed. Look at it, then write: reset mav1"

    def is_latched(message: Message) -> bool:
        if message["kind"] != "state":
            return False
        other, killed, _ = message["vehicles"]
        assert not other["latched"]
        return killed["latched"] == sentence

    async with opened(operated) as socket:
        await heard(socket, is_operator)
        for _ in range(2):
            await socket.send_str(json.dumps({"do": "order", "text": "kill mav1"}))
        told = await heard(socket, is_latched)
        assert told["vehicles"][1]["blocks"] == [sentence]
        await socket.send_str(json.dumps({"do": "order", "text": "reset mav1"}))
        await heard(socket, lambda m: m["kind"] == "state" and not is_latched(m))


async def test_the_alarm_of_a_kill_ends_on_all_pages_when_one_acknowledges_it(
    operated: Served,
) -> None:
    def kinds(message: Message) -> set[str]:
        return {alarm["kind"] for alarm in message.get("alarms", [])}

    event = Event(vehicle="mav1", stamp_ns=1, severity="critical", code="killed", sentence="Why.")
    operated.bus.tell("mav0", battery_frac=0.05)
    operated.bus.on_message[Topic.EVENT](Topic.EVENT, "mav1", event)
    async with opened(operated) as page, opened(operated) as other:
        await heard(page, lambda m: kinds(m) == {"killed in the air", "battery low"})
        for kind, subject in (("battery low", "mav0"), ("killed in the air", "mav1")):
            message = {"do": "acknowledge", "kind": kind, "subject": subject}
            await page.send_str(json.dumps(message))
        await heard(other, lambda m: kinds(m) == {"battery low"})


async def test_a_kill_that_was_not_sent_latches_nobody_and_drops_nothing(
    operated: Served, monkeypatch: pytest.MonkeyPatch
) -> None:
    def closed(*_: Any, **__: Any) -> None:
        raise RuntimeError("the bus is not open")

    async with opened(operated) as socket:
        await heard(socket, is_operator)
        await socket.send_str(json.dumps({"do": "order", "text": "takeoff mav1 1.0"}))
        await heard(socket, card("takeoff mav1 1.0", "previewed"))
        monkeypatch.setattr(FleetClient, "send", closed)
        for _ in range(2):
            await socket.send_str(json.dumps({"do": "order", "text": "kill mav1"}))
        not_sent = "the bus is not open"
        await heard(socket, lambda m: m["kind"] == "card" and not_sent in m["sentences"])
        await socket.send_str(json.dumps({"do": "order", "text": "takeoff mav1 2"}))
        again = await heard(socket, lambda m: m["kind"] == "card" and m["text"].endswith(" 2"))
        assert again["phase"] == "previewed", again["sentences"]


async def test_one_round_that_fails_ends_neither_the_page_nor_its_shutdown(
    operated: Served, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fails(*_: Any) -> None:
        raise ZeroDivisionError("a mistake")

    assert operated.feed.cards is not None
    monkeypatch.setattr(operated.feed.cards, "check_waiting", fails)
    async with opened(operated) as socket:
        await asyncio.sleep(3.0 * order_cards.CHECK_S)
        await heard(socket, lambda message: message["kind"] == "state")
        assert not any(task.done() for task in operated.feed._tasks)


async def test_control_is_not_taken_by_words_with_more_behind_them(operated: Served) -> None:
    async with opened(operated) as socket:
        await heard(socket, is_operator)
        for text in ("take control force tomorrow", "give control now", "keep control of it"):
            await socket.send_str(json.dumps({"do": "order", "text": text}))
            answer = await heard(socket, card(text, "refused"))
            assert answer["sentences"][0].startswith("Write: take control"), text


async def test_lines_after_which_nothing_is_under_way_are_answered(
    operated: Served, tmp_path: Path
) -> None:
    wait = tmp_path / "wait.toml"
    wait.write_text('schema = 1\n[[step]]\ndo = "wait"\nduration_s = 60.0\n')
    async with opened(operated) as socket:
        await heard(socket, is_operator)
        phases = {
            "take control": "answered",
            "reset": "answered",
            f"mission {wait}": "sent",
            "stop": "answered",
        }
        for text, phase in phases.items():
            await socket.send_str(json.dumps({"do": "order", "text": text}))
            await heard(socket, card(text, phase))
        await heard(socket, lambda m: m["kind"] == "card" and m["outcome"])


async def test_no_mission_takes_off_with_a_killed_vehicle_before_its_reset(
    operated: Served, tmp_path: Path
) -> None:
    hop = tmp_path / "hop.toml"
    hop.write_text('schema = 1\n[[step]]\ndo = "takeoff"\nheight_m = 1.0\n')
    at = (datetime.now().astimezone() + timedelta(minutes=5)).isoformat(timespec="seconds")
    later = f"mission {hop} at {at}"
    sentence = "mav1 was killed. Look at it, then write: reset mav1"
    async with opened(operated) as socket:
        await heard(socket, is_operator)
        await socket.send_str(json.dumps({"do": "order", "text": later}))
        await heard(socket, lambda m: card(later, "previewed")(m) and m.get("can_send"))

        for order in ("kill mav1", "kill mav1", f"mission {hop}"):
            await socket.send_str(json.dumps({"do": "order", "text": order}))
        waiting = await heard(
            socket, lambda m: card(later, "previewed")(m) and not m.get("can_send")
        )
        assert sentence in waiting["reasons"]

    async with opened(operated) as socket:
        refused = await heard(socket, card(f"mission {hop}", "refused"))
        assert refused["sentences"] == [sentence]
        await socket.send_str(json.dumps({"do": "order", "text": "reset mav1"}))
        await heard(socket, lambda m: card(later, "previewed")(m) and m.get("can_send"))
    assert [(name, order.kind) for name, order in operated.bus.orders] == [("mav1", "kill")]


async def test_a_kill_drops_what_waits_for_the_killed_vehicle(operated: Served) -> None:
    async with opened(operated) as socket:
        await heard(socket, is_operator)
        for order in ("takeoff mav0 1.0", "takeoff mav1 1.0", "kill mav1", "kill mav1"):
            await socket.send_str(json.dumps({"do": "order", "text": order}))
        await heard(socket, card("kill mav1", "sent"))
        dropped = await heard(socket, card("takeoff mav1 1.0", "dropped"))
        assert dropped["sentences"] == ["mav1 was killed."]

    async with opened(operated) as socket:
        await heard(socket, card("takeoff mav0 1.0", "previewed"))
        await socket.send_str(json.dumps({"do": "confirm", "number": dropped["number"]}))
        await heard(socket, lambda message: message["kind"] == "state")
    assert [(name, order.kind) for name, order in operated.bus.orders] == [("mav1", "kill")]


@pytest.mark.parametrize(
    "said",
    [
        "no JSON",
        "[]",
        '{"do": "order", "text": 7}',
        '{"do": "urgent", "verb": "kill"}',
        '{"do": "confirm", "number": 99}',
        '{"do": "confirm", "number": "1"}',
        '{"do": "launch"}',
        "[" * 60_000,
    ],
)
async def test_words_that_are_none_are_left_out_and_the_page_lives_on(
    operated: Served, said: str
) -> None:
    async with opened(operated) as socket:
        await heard(socket, is_operator)
        await socket.send_str(said)
        await heard(socket, lambda m: m["kind"] == "state")
    assert operated.bus.orders == []


async def test_an_order_that_names_many_vehicles_is_sent_and_a_line_that_is_too_long_refused(
    operated: Served,
) -> None:
    names = ",".join(["mav0", "mav1"] * 150)
    too_long = "land " + "x" * order_cards.MAX_LINE
    async with opened(operated) as socket:
        await heard(socket, is_operator)
        for text in (f"land {names}", too_long):
            await socket.send_str(json.dumps({"do": "order", "text": text}))
        await heard(socket, card(f"land {names}", "sent"))
        refused = await heard(socket, lambda m: m.get("phase") == "refused")
    assert refused["sentences"] == [
        "The line has 12005 letters, more than 12000, so nothing was sent. "
        "Order fewer vehicles at once."
    ]
    assert [name for name, _ in operated.bus.orders] == ["mav0", "mav1"]


@pytest.mark.parametrize("is_ascii", [True, False])
async def test_the_longest_line_fits_into_a_message_in_any_letters(
    operated: Served, is_ascii: bool
) -> None:
    line = "\N{HELICOPTER}" * order_cards.MAX_LINE
    async with opened(operated) as socket:
        await heard(socket, is_operator)
        await socket.send_str(json.dumps({"do": "order", "text": line}, ensure_ascii=is_ascii))
        await heard(socket, lambda m: m.get("phase") == "refused")
    async with (
        aiohttp.ClientSession() as session,
        session.get(operated.address) as response,
    ):
        assert f'maxlength="{order_cards.MAX_LINE}"' in await response.text()


async def test_names_and_sentences_with_markup_arrive_as_they_are_written(operated: Served) -> None:
    markup = "<img src=x onerror=alert(1)>"
    async with opened(operated) as socket:
        await heard(socket, is_operator)
        await socket.send_str(json.dumps({"do": "order", "text": markup}))
        refused = await heard(socket, card(markup, "refused"))
        assert refused["sentences"]
    # the page's scripts put texts into elements as text only
    for name in ("live.js", "live_scene.js", "elements.js"):
        async with (
            aiohttp.ClientSession() as session,
            session.get(f"{operated.address}files/{name}") as response,
        ):
            script = await response.text()
        assert "innerHTML" not in script
        assert "insertAdjacentHTML" not in script


async def test_half_a_letter_in_an_order_closes_neither_this_page_nor_later_ones(
    operated: Served,
) -> None:
    async with opened(operated) as socket:
        await heard(socket, is_operator)
        await socket.send_str('{"do": "order", "text": "fly \\ud83d"}')
        await heard(socket, card("fly ?", "refused"))
        async with opened(operated) as later:
            await heard(later, card("fly ?", "refused"))


async def test_a_page_that_cannot_be_opened_takes_no_place(
    watched: Served, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail() -> None:
        raise RuntimeError

    monkeypatch.setattr(watched.feed, "open", fail)
    async with opened(watched) as socket:
        assert (await socket.receive()).type is not aiohttp.WSMsgType.TEXT
    assert not watched.server._sockets


@pytest.mark.parametrize(
    "headers",
    [
        {"Host": "evil.example"},
        {"Origin": "http://evil.example"},
        {"Origin": "null"},
        {"Host": "[::1"},
        {"Origin": "http://[x"},
    ],
)
async def test_other_sites_in_the_same_browser_are_refused(
    operated: Served, headers: dict[str, str]
) -> None:
    async with aiohttp.ClientSession() as session:
        for path in ("", "ws", "files/live.js"):
            async with session.get(operated.address + path, headers=headers) as response:
                assert response.status == 403, path


async def test_pages_that_can_order_stand_behind_their_key(fleet: FleetConfig) -> None:
    async for served in serve(fleet, can_order=True, key="secret"):
        assert served.address.endswith("/secret/")
        root = served.address.removesuffix("secret/")
        async with aiohttp.ClientSession() as session:
            for path in ("", "ws", "files/live.js", "wrong/", "secre/"):
                async with session.get(root + path) as response:
                    assert response.status == 403, path
            async with session.get(served.address) as response:
                assert response.status == 200


async def test_one_page_too_many_is_turned_away(
    watched: Served, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(page_server, "MAX_PAGES", 2)
    async with aiohttp.ClientSession() as session:
        first = await session.ws_connect(watched.address + "ws")
        second = await session.ws_connect(watched.address + "ws")
        await heard(second, lambda m: m["kind"] == "state")
        third = await session.ws_connect(watched.address + "ws")
        assert (await third.receive()).type is aiohttp.WSMsgType.CLOSE
        for socket in (first, second, third):
            await socket.close()


async def test_a_page_that_sends_many_lines_at_once_closes_no_other_page(
    fleet: FleetConfig, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(live_feed, "MAX_QUEUED", 50)
    lines = 2000

    async def count_cards(page: aiohttp.ClientWebSocketResponse) -> int:
        cards = 0
        while cards < lines:
            message = await page.receive()
            assert message.type is aiohttp.WSMsgType.TEXT, f"closed after {cards} cards"
            cards += json.loads(message.data)["kind"] == "card"
        return cards

    async for served in serve(fleet, can_order=True):
        async with aiohttp.ClientSession() as session:
            reading = await session.ws_connect(served.address + "ws")
            sending = await session.ws_connect(served.address + "ws")
            counting = [asyncio.create_task(count_cards(page)) for page in (reading, sending)]
            for _ in range(lines):
                await sending.send_json({"do": "order", "text": "nonsense"})
            async with asyncio.timeout(60.0):
                assert await asyncio.gather(*counting) == [lines, lines]
            for page in (reading, sending):
                await page.close()


@pytest.mark.realtime
async def test_of_200_sockets_at_once_50_are_served_and_one_that_answers_nothing_is_closed(
    watched: Served, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(page_server, "_HEARTBEAT_S", 5.0)
    silent = await silent_page(watched)
    served = page_server.MAX_PAGES - 1  # beside it

    states: Counter[int] = Counter()

    async def read(number: int, page: aiohttp.ClientWebSocketResponse) -> None:
        async for message in page:
            states[number] += json.loads(message.data)["kind"] == "state"

    async with aiohttp.ClientSession(connector=aiohttp.TCPConnector(limit=0)) as session:
        url = watched.address + "ws"
        pages = await asyncio.gather(*(session.ws_connect(url) for _ in range(200)))
        readers = [asyncio.create_task(read(*one)) for one in enumerate(pages)]
        await until(lambda: len(states) == served and sum(page.closed for page in pages) >= 151)
        closed = [page.close_code for page in pages if page.closed]
        assert closed == [aiohttp.WSCloseCode.TRY_AGAIN_LATER] * (200 - served)

        # the silent one answers no heartbeat
        await until(lambda: watched.feed.pages == served)

        before = Counter(states)
        await until(lambda: all(states[number] > before[number] for number in before))

        for page in pages:
            await page.close()
        await asyncio.gather(*readers)
    silent.close()


async def silent_page(served: Served) -> socket.socket:
    """A connection that asks for the socket of a page, and reads nothing of it."""
    address = urlsplit(served.address)
    assert address.hostname is not None
    assert address.port is not None
    connection = socket.socket()
    connection.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
    connection.setblocking(False)
    loop = asyncio.get_running_loop()
    await loop.sock_connect(connection, (address.hostname, address.port))
    words = (
        f"GET /ws HTTP/1.1\r\nHost: {address.netloc}\r\nUpgrade: websocket\r\n"
        "Connection: Upgrade\r\nSec-WebSocket-Version: 13\r\n"
        "Sec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==\r\n\r\n"
    )
    await loop.sock_sendall(connection, words.encode())
    await until(lambda: served.feed.pages == 1)
    return connection


async def until(has_come: Callable[[], bool]) -> None:
    """Wait until something has come about."""
    async with asyncio.timeout(60.0):
        while not has_come():  # noqa: ASYNC110 - several sockets together have no event
            await asyncio.sleep(0.02)


async def test_a_page_that_takes_nothing_is_closed_and_holds_up_nobody(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(live_feed, "SEND_LIMIT_S", 0.05)
    slow = live_feed.Page()
    slow.tell("an event")

    async def never(_: str) -> None:
        await asyncio.Event().wait()

    with pytest.raises(live_feed.TooSlow):
        await slow.send_all(never)

    full = live_feed.Page()
    for _ in range(live_feed.MAX_QUEUED + 1):
        full.tell("an event")
    with pytest.raises(live_feed.TooSlow):
        await full.send_all(never)


async def test_of_states_that_wait_a_page_gets_the_newest_only() -> None:
    page = live_feed.Page()
    for number in range(5):
        page.tell_state(f"state {number}")
    sent: list[str] = []

    async def send(text: str) -> None:
        sent.append(text)

    with pytest.raises(TimeoutError):
        async with asyncio.timeout(0.1):
            await page.send_all(send)
    assert sent == ["state 4"]


async def first_state(page: live_feed.Page) -> Message:
    """The first state that is sent to a page."""
    texts: asyncio.Queue[str] = asyncio.Queue()
    sending = asyncio.create_task(page.send_all(texts.put))
    try:
        while True:
            message: Message = json.loads(await texts.get())
            if message["kind"] == "state":
                return message
    finally:
        sending.cancel()


async def test_alarms_that_begin_while_no_page_is_open_have_their_age() -> None:
    client: Any = SteadyClient(crowd(1))
    feed = LiveFeed(client.fleet, client, can_order=False)
    for _ in range(2):
        client.hear("v000", is_airborne=True, battery_frac=0.05)
        feed._tell_state()
        client.clock_ns += 60 * 10**9
    state = await first_state(feed.open())
    assert state["alarms"][0]["for_s"] == pytest.approx(120.0)
    # the page draws an alarm by this word
    assert state["alarms"][0]["severity"] in ("note", "warning", "critical")


@pytest.mark.parametrize("host", ["0.0.0.0", "192.168.1.4", "example.org", ""])
def test_the_page_is_for_this_machine_only(host: str) -> None:
    with pytest.raises(ConfigError, match="for this machine only"):
        require_loopback(host)


async def test_pictures_of_the_ground_come_from_this_server_behind_its_key(
    fleet: FleetConfig,
) -> None:
    corners = ((-9.0, 9.0), (9.0, 9.0), (-9.0, -9.0), (9.0, -9.0))
    ground = GroundTiles("Ada", (GroundTile(corners_enu_m=corners, png=b"a picture"),))
    async for served in serve(fleet, can_order=True, key="secret", ground=ground):
        async with aiohttp.ClientSession() as session:
            async with session.ws_connect(urljoin(served.address, "ws")) as socket:
                told = json.loads(await socket.receive_str())
            assert told["ground"]["attribution"] == "Ada"
            (tile,) = told["ground"]["tiles"]
            assert tile["corners_enu_m"] == [list(corner) for corner in corners]

            async with session.get(urljoin(served.address, tile["source"])) as answer:
                assert (answer.status, answer.content_type) == (200, "image/png")
                assert await answer.read() == b"a picture"
                assert "img-src 'self' data:" in answer.headers["Content-Security-Policy"]
            for path, status in (
                ("tiles/1", 404),
                ("tiles/..%2f..%2fsecret", 404),
                ("/tiles/0", 403),
            ):
                async with session.get(urljoin(served.address, path)) as answer:
                    assert answer.status == status
