"""Executes the core's commands, in order.

Setpoints and requests go to PX4; messages, replies and subscriptions go to the bus. Calls that may
block (reliable messages, subscriptions) run on their own threads, so that nothing delays the
setpoint of a tick.
"""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Iterable
from typing import Any

from onboard import agent_commands
from onboard.agent.inbox import Inbox
from onboard.autopilot import Autopilot
from onboard.bus.protocol import Bus
from onboard.bus.schema import OrderReply
from onboard.bus.topics import TOPICS, Delivery, Topic
from onboard.process.background_queue import BackgroundQueue

# a setpoint that is later than this after the start of its tick is not sent
_LATEST_SETPOINT_NS = 60_000_000

log = logging.getLogger("covey.agent")

OnReply = Callable[[OrderReply], None]


class CommandExecutor:
    """Executes commands in order.

    Args:
        name: name of the vehicle.
        others: names of the other vehicles of the fleet.
        link: link to PX4.
        bus: bus of the fleet.
        inbox: receives the messages of the subscriptions.
        on_exit: function that ends the process.
        on_dropped: function that is called when a setpoint is too old to be sent.
    """

    def __init__(
        self,
        name: str,
        others: Iterable[str],
        link: Autopilot,
        bus: Bus,
        inbox: Inbox,
        on_exit: Callable[[], None],
        on_dropped: Callable[[], None],
    ) -> None:
        self.tick_ns = 0  # time at which the tick began
        self.reliable = BackgroundQueue("bus")  # messages that must arrive
        self._subscriptions = BackgroundQueue("interest")
        self._name = name
        self._names = {name, *others}
        self._link = link
        self._bus = bus
        self._inbox = inbox
        self._on_dropped = on_dropped
        self._replies: dict[str, OnReply] = {}  # order id -> function that replies to its sender
        self._actions: dict[type, Callable[[Any], object]] = {
            agent_commands.SendAttitude: self._send_attitude,
            agent_commands.Publish: self._publish,
            agent_commands.SendOdometry: self._send_odometry,
            agent_commands.SendCorrections: self._send_corrections,
            agent_commands.Reply: self._reply,
            agent_commands.WatchBodies: self._watch_bodies,
            agent_commands.Follow: self._follow,
            agent_commands.SetOffboard: lambda _: self._link.set_offboard(),
            agent_commands.Arm: lambda _: self._link.arm(),
            agent_commands.Disarm: lambda _: self._link.disarm(),
            agent_commands.Px4Land: lambda _: self._link.land(),
            agent_commands.Kill: lambda _: self._link.kill(),
            agent_commands.RequestHeartbeat: lambda _: self._link.request_heartbeat(),
            agent_commands.RebootPx4: lambda _: self._link.reboot(),
            agent_commands.PlayTune: lambda _: self._link.play_tune(),
            agent_commands.Exit: lambda _: on_exit(),
        }

    def start_threads(self) -> None:
        """Start the threads now, before the process takes its realtime priority for all threads."""
        # the first call of a queue starts its thread; int() does nothing
        self.reliable.submit(int)
        self._subscriptions.submit(int)

    def stop(self) -> None:
        """Execute everything that is still queued, and end the threads."""
        self._subscriptions.stop()
        self.reliable.stop()

    def expect_reply(self, order_id: str, reply: OnReply) -> None:
        """Keep the function that replies to the sender of an order."""
        self._replies[order_id] = reply

    def execute(self, commands: Iterable[agent_commands.Command]) -> None:
        """Execute commands in order."""
        for command in commands:
            self._actions[type(command)](command)

    def _send_attitude(self, command: agent_commands.SendAttitude) -> None:
        if time.monotonic_ns() - self.tick_ns < _LATEST_SETPOINT_NS:
            self._link.send_attitude(command.setpoint)
        else:
            self._on_dropped()

    def _publish(self, command: agent_commands.Publish) -> None:
        topic = command.topic
        message = command.message
        if TOPICS[topic].delivery is Delivery.RELIABLE:
            log.info("%s", getattr(message, "sentence", topic.value))
            self.reliable.submit(self._bus.publish, topic, self._name, message)
        else:
            self._bus.publish(topic, self._name, message)

    def _send_odometry(self, command: agent_commands.SendOdometry) -> None:
        self._link.send_odometry(
            command.position_enu_m,
            command.quaternion_enu_flu_wxyz,
            command.std_m,
            command.reset_count,
        )

    def _send_corrections(self, command: agent_commands.SendCorrections) -> None:
        self._link.send_corrections(command.flags, command.data)

    def _reply(self, command: agent_commands.Reply) -> None:
        reply = self._replies.pop(command.reply.order_id, None)
        if reply is not None:
            self.reliable.submit(reply, command.reply)

    def _watch_bodies(self, command: agent_commands.WatchBodies) -> None:
        self._subscriptions.submit(self._inbox.watch_bodies, command.bodies)

    def _follow(self, command: agent_commands.Follow) -> None:
        on_message = self._inbox.neighbour_received
        self._subscriptions.submit(self._bus.follow, Topic.STATE, command.names, on_message)

        # Only the slow states (topic FAR) are read from vehicles that are not followed. A slow
        # state under our own name comes from a second agent of this vehicle.
        slow_names = self._names - command.names
        slow_names.add(self._name)
        self._subscriptions.submit(self._bus.follow, Topic.FAR, slow_names, on_message)
