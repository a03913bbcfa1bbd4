"""``covey web foxglove``: a flying fleet for Foxglove and Lichtblick, live.

Examples:
  covey web foxglove --fleet fleet.toml
  covey web foxglove --fleet fleet.toml --port 0

Open ws://127.0.0.1:8765 in the viewer as a "Foxglove WebSocket". The topics are
those of covey log export --foxglove. The server only watches the fleet, and
accepts no input from viewers.

Exit status: 0 ended by an interrupt; 2 wrong input, nothing was served.
"""

from __future__ import annotations

import asyncio
import contextlib
import time

from groundstation.client.client import FleetClient
from groundstation.client.ground_node import session
from groundstation.commands.parameters import File
from groundstation.recording.channels import rows
from groundstation.web.page_server import require_loopback
from onboard.bus.control_token import WATCHER
from onboard.bus.schema import Event, Message
from onboard.bus.topics import Topic
from onboard.config.fleet import ConfigError, FleetConfig, load_fleet
from onboard.end_signals import end_signals
from onboard.exit_status import EXIT_OK

_SCENE_S = 0.1  # period of the moving part of the scene
_STATIC_S = 5.0  # period of fence and obstacles, so that a viewer that connects later gets them


def foxglove(*, fleet: File, port: int = 8765, host: str = "127.0.0.1") -> int:
    """Serve a flying fleet to viewers of Foxglove's WebSocket on this machine.

    Args:
        fleet: fleet file
        port: 0 takes any
        host: a loopback address
    """
    if not 0 <= port <= 65535:
        raise ConfigError(f"--port {port}: ports lie between 0 and 65535.")
    require_loopback(host)
    return asyncio.run(_serve(load_fleet(fleet), host, port))


async def _serve(fleet: FleetConfig, host: str, port: int) -> int:
    """Serve a fleet until an interrupt; return the exit status."""
    # Imported here: only this function needs the libraries of the extra `viewers`.
    from groundstation.viewers.live_scene import LiveScene
    from groundstation.viewers.live_server import LiveServer
    from groundstation.viewers.scene_messages import event_line, static_scene, timestamp

    client = FleetClient(fleet, operates=False, bus=session(fleet, WATCHER))
    server = LiveServer(f"Covey: {fleet.fleet.name}")
    # Viewers show the time of day, the bus has a monotonic clock.
    shift_ns = time.time_ns() - client.now_ns()

    def put(topic: Topic, name: str, message: Message, received_ns: int) -> None:
        """Pass on a message of the bus."""
        stamp_ns = received_ns + shift_ns
        for channel, kind, _, data in rows(topic, name, message, received_ns):
            server.put_json(channel, kind, data, stamp_ns)
        if isinstance(message, Event):
            line = event_line(message)
            line.timestamp.CopyFrom(timestamp(stamp_ns))
            server.put("/log", line, stamp_ns)

    ended = asyncio.Event()
    loop = asyncio.get_running_loop()
    for number in end_signals():
        loop.add_signal_handler(number, ended.set)

    served_port = server.start(host, port)
    try:
        client.add_sink(put)
        await client.start()
        with contextlib.suppress(BrokenPipeError):
            print(
                f"Covey: {fleet.fleet.name}: open ws://{host}:{served_port} in a viewer on this "
                "machine. Ctrl-C ends it.",
                flush=True,
            )

        scene = LiveScene(fleet)
        next_static_s = 0.0
        while not ended.is_set():
            now_ns = client.now_ns()
            stamp_ns = now_ns + shift_ns
            for channel, content in scene.messages(client.state, now_ns, stamp_ns):
                server.put(channel, content, stamp_ns)
            if now_ns * 1e-9 >= next_static_s:
                next_static_s = now_ns * 1e-9 + _STATIC_S
                server.put("/scene/static", static_scene(fleet, stamp_ns), stamp_ns)

            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout(_SCENE_S):
                    await ended.wait()
    finally:
        server.stop()
        await client.stop()
    return EXIT_OK
