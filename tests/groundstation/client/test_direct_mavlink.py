"""The direct path beside an autopilot, and beside sockets that play one."""

from __future__ import annotations

import asyncio
import contextlib
import errno
import os
import socket
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from typing import Any

import pytest
from pymavlink.dialects.v20 import common

from groundstation.client import mavlink_port
from groundstation.client.direct_mavlink import (
    DirectCommand,
    DirectKind,
    send_direct,
    send_in_thread,
)

ARMED = 128
LANDING = 4 << 16 | 6 << 24
KILL = 400
NAV_LAND = 21
OURS = (255, 190)


class Autopilot(threading.Thread):
    """A PX4 of one socket: answers each command with what ``answer`` packs, and counts the
    commands.
    """

    def __init__(
        self,
        answer: Callable[[Autopilot, int], list[Any]],
        system: int = 1,
        component: int = 1,
        address: tuple[str, int] = ("127.0.0.1", 0),
    ) -> None:
        super().__init__(daemon=True)
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.bind(address)
        self.socket.settimeout(0.05)
        self.port = self.socket.getsockname()[1]
        self.mav = common.MAVLink(None, srcSystem=system, srcComponent=component)
        self.answer = answer
        self.count = 0
        self.is_ended = threading.Event()
        self.client: tuple[str, int] = ("", 0)

    def run(self) -> None:
        while not self.is_ended.is_set():
            try:
                data, self.client = self.socket.recvfrom(2048)
            except TimeoutError:
                continue
            for message in self.mav.parse_buffer(data) or ():
                if message.get_type() == "COMMAND_LONG":
                    self.count += 1
                    for reply in self.answer(self, message.command):
                        self.socket.sendto(reply.pack(self.mav), self.client)


@contextmanager
def flying(answer: Callable[[Autopilot, int], list[Any]], **own: Any) -> Iterator[Autopilot]:
    autopilot = Autopilot(answer, **own)
    autopilot.start()
    try:
        yield autopilot
    finally:
        autopilot.is_ended.set()
        autopilot.join(2.0)
        autopilot.socket.close()


def ack(command: int, target: tuple[int, int] = OURS, result: int = 0) -> Any:
    return common.MAVLink_command_ack_message(command, result, 0, 0, *target)


def heartbeat(*, is_armed: bool, custom_mode: int = 0) -> Any:
    return common.MAVLink_heartbeat_message(2, 12, ARMED if is_armed else 0, custom_mode, 4, 3)


def test_a_kill_is_repeated_after_its_acknowledgement_until_the_heartbeat_shows_it() -> None:
    def answer(px4: Autopilot, command: int) -> list[Any]:
        return [ack(command), heartbeat(is_armed=px4.count < 4)]

    with flying(answer) as px4:
        result = send_direct(
            f"udpout://127.0.0.1:{px4.port}", 1, "kill", timeout_s=5.0, watch_s=5.0
        )
    assert result.is_disarmed
    assert result.sentence == "PX4 accepted it, and it is disarmed"
    assert px4.count == 4


def command(px4: Autopilot, kind: DirectKind, watch_s: float) -> DirectCommand:
    return DirectCommand(f"udpout://127.0.0.1:{px4.port}", 1, kind, timeout_s=2.0, watch_s=watch_s)


async def test_px4s_with_the_same_port_at_different_addresses_are_all_heard() -> None:
    """Each drone of a lab has its own address, and the ground link has the same port on all."""

    def answer(px4: Autopilot, command: int) -> list[Any]:
        if px4.count < 3:  # until all links are open
            return []
        return [ack(command), heartbeat(is_armed=False)]

    with contextlib.ExitStack() as stack:
        first = stack.enter_context(flying(answer))
        hosts = ["127.0.0.1", "127.0.0.2", "127.0.0.3"]
        for system, host in enumerate(hosts[1:], start=2):
            stack.enter_context(flying(answer, system=system, address=(host, first.port)))
        kills = [
            DirectCommand(
                f"udpout://{host}:{first.port}", system, "kill", timeout_s=2.0, watch_s=1.0
            )
            for system, host in enumerate(hosts, start=1)
        ]
        results = await asyncio.gather(*(send_in_thread(kill) for kill in kills))
    assert [result.is_disarmed for result in results] == [True, True, True], results


async def test_a_kill_waits_for_no_landing_that_is_under_way() -> None:
    """More landings than the event loop's own executor has threads, two for each vehicle."""
    was_killed = threading.Event()

    def answer(px4: Autopilot, command: int) -> list[Any]:
        if command == KILL:
            was_killed.set()
        mode = LANDING if command == NAV_LAND else 0
        return [ack(command), heartbeat(is_armed=not was_killed.is_set(), custom_mode=mode)]

    with flying(answer) as px4:
        landings = [
            asyncio.create_task(send_in_thread(command(px4, "land", watch_s=1.5)))
            for _ in range((os.cpu_count() or 1) + 8)
        ]
        await asyncio.sleep(0.3)
        killed = await asyncio.wait_for(send_in_thread(command(px4, "kill", watch_s=1.0)), 1.0)
        assert killed.is_disarmed
        await asyncio.gather(*landings)


async def test_a_link_that_no_longer_gets_the_answers_is_not_used_again() -> None:
    """Two landings overlap, and the first, whose link is the older one, ends first."""

    def answer(px4: Autopilot, command: int) -> list[Any]:
        if command == KILL:
            return [ack(command), heartbeat(is_armed=False)]
        return [ack(command), heartbeat(is_armed=True, custom_mode=LANDING)]

    with flying(answer) as px4:
        first = asyncio.create_task(send_in_thread(command(px4, "land", watch_s=0.3)))
        await asyncio.sleep(0.1)
        second = asyncio.create_task(send_in_thread(command(px4, "land", watch_s=1.0)))
        await first
        killed = await send_in_thread(command(px4, "kill", watch_s=1.0))
        assert killed.is_disarmed, killed
        await second


class Refusing:
    """A connected socket on whose way a router refuses each datagram for a while."""

    def __init__(self, port: socket.socket) -> None:
        self._port = port
        self.left = 3  # of the errors

    def __getattr__(self, name: str) -> Any:
        return getattr(self._port, name)

    def _fail(self) -> None:
        self.left -= 1
        if self.left >= 0:
            raise OSError(errno.EHOSTUNREACH, "No route to host")

    def send(self, data: bytes) -> int:
        self._fail()
        return self._port.send(data)

    def recvfrom(self, size: int) -> tuple[bytes, Any]:
        self._fail()
        return self._port.recvfrom(size)


def test_a_kill_is_repeated_while_somebody_on_the_way_refuses_it() -> None:
    with flying(lambda px4, command: [ack(command), heartbeat(is_armed=False)]) as px4:
        endpoint = f"udpout://127.0.0.1:{px4.port}"
        link = mavlink_port.take_link(endpoint)
        link.port = Refusing(link.port)
        mavlink_port.keep_link(endpoint, link)
        result = send_direct(endpoint, 1, "kill", timeout_s=2.0, watch_s=1.0)
    assert result.is_disarmed, result
    assert link.port.left < 0


def test_a_link_from_an_address_that_this_computer_no_longer_has_is_opened_anew() -> None:
    with flying(lambda px4, command: []) as px4:
        endpoint = f"udpout://127.0.0.1:{px4.port}"
        link = mavlink_port.take_link(endpoint)
        other = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        other.bind(("127.0.0.2", 0))
        link.port.close()
        link.port = other
        mavlink_port.keep_link(endpoint, link)
        again = mavlink_port.take_link(endpoint)
        assert again is not link
        assert again.port.getsockname()[0] == "127.0.0.1"
        mavlink_port.keep_link(endpoint, again)
        assert mavlink_port.take_link(endpoint) is again


def test_a_kill_that_only_the_heartbeat_confirms_is_done() -> None:
    with flying(lambda px4, command: [heartbeat(is_armed=False)]) as px4:
        result = send_direct(f"udpout://127.0.0.1:{px4.port}", 1, "kill", timeout_s=5.0)
    assert (result.is_accepted, result.is_disarmed) == (True, True)
    assert result.sentence == "PX4 did not acknowledge it, and it is disarmed"


def test_a_landing_is_repeated_until_px4_shows_it_and_then_left_to_px4() -> None:
    def answer(px4: Autopilot, command: int) -> list[Any]:
        assert command == NAV_LAND
        if px4.count < 3:
            return [ack(command, result=1), heartbeat(is_armed=True)]
        return [ack(command), heartbeat(is_armed=True, custom_mode=LANDING)]

    with flying(answer) as px4:
        result = send_direct(
            f"udpout://127.0.0.1:{px4.port}", 1, "land", timeout_s=5.0, watch_s=0.8
        )
    assert (result.is_accepted, result.is_disarmed) == (True, False)
    assert px4.count == 3


@pytest.mark.parametrize(
    ("system", "component", "target"),
    [(2, 1, OURS), (1, 195, OURS), (1, 1, (42, 7)), (1, 1, (255, 191))],
)
def test_an_acknowledgement_of_another_sender_or_for_another_ground_does_not_count(
    system: int, component: int, target: tuple[int, int]
) -> None:
    def answer(px4: Autopilot, command: int) -> list[Any]:
        beats = [] if (system, component) == (1, 1) else [heartbeat(is_armed=False)]
        return [ack(command, target), *beats]

    with flying(answer, system=system, component=component) as px4:
        result = send_direct(f"udpout://127.0.0.1:{px4.port}", 1, "kill", timeout_s=0.7)
    assert (result.is_accepted, result.is_disarmed) == (False, False), result
    assert px4.count >= 3


def test_another_socket_that_plays_the_autopilot_is_not_heard() -> None:
    with (
        flying(lambda px4, command: []) as impostor,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other,
    ):

        def answer(px4: Autopilot, command: int) -> list[Any]:
            for message in (ack(command), heartbeat(is_armed=False)):
                other.sendto(message.pack(impostor.mav), px4.client)
            return [heartbeat(is_armed=True)]

        with flying(answer) as px4:
            result = send_direct(f"udpout://127.0.0.1:{px4.port}", 1, "kill", timeout_s=0.7)
    assert (result.is_accepted, result.is_disarmed) == (False, False), result
    assert "did not answer" in result.sentence


POSCTL = 3 << 16
HOLD = 4 << 16 | 3 << 24


def _sticks() -> Any:
    return common.MAVLink_manual_control_message(1, 0, 0, 500, 0, 0)


@pytest.mark.parametrize(
    ("mode", "sticks", "is_spared"),
    [(POSCTL, 2, True), (POSCTL, 1, False), (POSCTL, 0, False), (HOLD, 2, False)],
)
def test_a_landing_that_spares_pilots_asks_px4_first(
    mode: int, sticks: int, is_spared: bool
) -> None:
    commands: list[int] = []

    def answer(px4: Autopilot, command: int) -> list[Any]:
        commands.append(command)
        if command == NAV_LAND:
            return [ack(command), heartbeat(is_armed=True, custom_mode=LANDING)]
        # one message comes with the stream, whether sticks are heard or not
        is_sent = command == 511 and commands.count(511) <= sticks
        sent = [_sticks()] if is_sent else []
        return [heartbeat(is_armed=True, custom_mode=mode), *sent]

    with flying(answer) as px4:
        result = send_direct(
            f"udpout://127.0.0.1:{px4.port}",
            1,
            "land",
            timeout_s=2.0,
            watch_s=0.2,
            spares_pilot=True,
        )
    assert result.is_flown_by_hand is is_spared
    assert (NAV_LAND in commands) is not is_spared
    assert result.is_accepted is not is_spared


@pytest.mark.parametrize("was_flown_by_hand", [True, False])
def test_where_px4_answers_another_ground_the_agents_last_word_counts(
    was_flown_by_hand: bool,
) -> None:
    commands: list[int] = []

    def answer(px4: Autopilot, command: int) -> list[Any]:
        commands.append(command)
        return []

    with flying(answer) as px4:
        result = send_direct(
            f"udpout://127.0.0.1:{px4.port}",
            1,
            "land",
            timeout_s=0.5,
            spares_pilot=True,
            was_flown_by_hand=was_flown_by_hand,
        )
    assert result.is_flown_by_hand is was_flown_by_hand
    assert (NAV_LAND in commands) is not was_flown_by_hand


def test_a_landing_of_a_person_by_name_asks_nothing() -> None:
    commands: list[int] = []

    def answer(px4: Autopilot, command: int) -> list[Any]:
        commands.append(command)
        return [ack(command), heartbeat(is_armed=True, custom_mode=LANDING)]

    with flying(answer) as px4:
        result = send_direct(f"udpout://127.0.0.1:{px4.port}", 1, "land", timeout_s=2.0)
    assert result.is_accepted
    assert set(commands) == {NAV_LAND}


def test_a_tcp_link_that_the_other_side_has_closed_is_opened_anew() -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        server.settimeout(5.0)
        port = server.getsockname()[1]

        def answer_once() -> None:
            connection, _ = server.accept()
            connection.settimeout(0.5)
            mav = common.MAVLink(None, srcSystem=1, srcComponent=1)
            with connection, suppress(TimeoutError):
                while data := connection.recv(2048):
                    for message in mav.parse_buffer(data) or ():
                        if message.get_type() == "COMMAND_LONG":
                            connection.sendall(heartbeat(is_armed=False).pack(mav))

        results = []
        for _ in range(2):  # the router in between restarts after the first command
            router = threading.Thread(target=answer_once, daemon=True)
            router.start()
            results.append(send_direct(f"tcp://127.0.0.1:{port}", 1, "kill", timeout_s=1.0))
            router.join(2.0)
    assert [result.is_disarmed for result in results] == [True, True], results


@pytest.mark.parametrize("listens", [True, False], ids=["closes at once", "nobody listens"])
def test_a_tcp_link_that_does_not_work_is_said_without_a_print_and_without_computing(
    listens: bool, capfd: pytest.CaptureFixture[str]
) -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        port = server.getsockname()[1]

        def close_at_once() -> None:
            server.accept()[0].close()

        if listens:
            threading.Thread(target=close_at_once, daemon=True).start()
        else:
            server.close()
        computed_s = time.thread_time()
        answer = send_direct(f"tcp://127.0.0.1:{port}", 1, "land", timeout_s=1.0)

    assert not answer.has_answered
    assert capfd.readouterr() == ("", "")
    assert time.thread_time() - computed_s < 0.4


def test_a_port_that_does_not_exist_is_said_instead_of_failing() -> None:
    answer = send_direct("udpout://127.0.0.1:99999", 1, "kill", timeout_s=0.1)
    assert not answer.has_answered
    assert "cannot be opened" in answer.sentence


def test_a_host_that_does_not_answer_holds_up_no_link_of_another_vehicle() -> None:
    with (
        socket.socket() as full,
        contextlib.ExitStack() as waiting,
        flying(lambda autopilot, command: []) as other,
    ):
        full.bind(("127.0.0.1", 0))
        full.listen(0)
        host_and_port = full.getsockname()
        for _ in range(3):  # nobody accepts them, so that the next one waits
            client = waiting.enter_context(socket.socket())
            client.setblocking(False)
            client.connect_ex(host_and_port)

        stuck = threading.Thread(
            target=send_direct,
            args=(f"tcp://127.0.0.1:{host_and_port[1]}", 1, "kill"),
            kwargs={"timeout_s": 0.1},
            daemon=True,
        )
        stuck.start()
        time.sleep(0.3)
        assert stuck.is_alive(), "the first host does not answer"

        begin_s = time.monotonic()
        send_direct(f"udpout://127.0.0.1:{other.port}", 1, "kill", timeout_s=0.5)
        assert time.monotonic() - begin_s < 3.0
        assert other.count >= 1
