"""Serves messages to Foxglove and Lichtblick by foxglove-sdk.

This is the only file that imports foxglove-sdk. The server accepts nothing from its clients: no
parameters, no calls, no messages. A slow client loses the oldest messages, and delays no other.
"""

from __future__ import annotations

from typing import Any

import foxglove
from foxglove import Channel, Context, Schema
from foxglove.websocket import WebSocketServer
from mcap_protobuf.schema import build_file_descriptor_set

from groundstation.recording.channels import json_schema
from onboard.config.fleet import ConfigError

MAX_CHANNELS = 1_000
_BACKLOG = 256  # most messages that wait for one client


class LiveServer:
    """Serves messages to all clients that connect.

    Args:
        name: the fleet's name, which viewers show.
    """

    def __init__(self, name: str) -> None:
        self._name = name
        self._context = Context()
        self._channels: dict[str, Channel] = {}
        self._server: WebSocketServer | None = None

    def start(self, host: str, port: int) -> int:
        """Begin to listen.

        Args:
            host: a loopback address.
            port: the port; 0 takes any free one.

        Returns:
            The port on which the server listens.

        Raises:
            ConfigError: the port cannot be opened.
        """
        try:
            self._server = foxglove.start_server(
                name=self._name,
                host=host,
                port=port,
                capabilities=[],
                context=self._context,
                message_backlog_size=_BACKLOG,
            )
        except (OSError, RuntimeError) as error:
            raise ConfigError(
                f"--port {port}: it cannot be opened ({error}). Give another one, or 0 for any."
            ) from None
        return self._server.port

    def stop(self) -> None:
        """Close all connections; a second call does nothing."""
        if self._server is not None:
            self._server.stop()
        self._server = None

    def put(self, topic: str, content: Any, stamp_ns: int) -> None:
        """Send a message of protobuf to all clients that subscribe to its topic."""
        channel = self._channels.get(topic)
        if channel is None:
            kind = type(content)
            data = build_file_descriptor_set(kind).SerializeToString()
            schema = Schema(name=kind.DESCRIPTOR.full_name, encoding="protobuf", data=data)
            channel = self._opened(topic, "protobuf", schema)
        if channel is not None:
            channel.log(content.SerializeToString(), log_time=stamp_ns)

    def put_json(self, topic: str, kind: type[Any], data: bytes, stamp_ns: int) -> None:
        """Send one of the fleet's own messages, encoded as in a record."""
        channel = self._channels.get(topic)
        if channel is None:
            schema = Schema(
                name=f"covey.{kind.__name__}", encoding="jsonschema", data=json_schema(kind)
            )
            channel = self._opened(topic, "json", schema)
        if channel is not None:
            channel.log(data, log_time=stamp_ns)

    def _opened(self, topic: str, encoding: str, schema: Schema) -> Channel | None:
        """Return a new channel; None if there are too many, as when a peer floods the bus."""
        if len(self._channels) >= MAX_CHANNELS:
            return None
        channel = Channel(topic, schema=schema, message_encoding=encoding, context=self._context)
        self._channels[topic] = channel
        return channel
