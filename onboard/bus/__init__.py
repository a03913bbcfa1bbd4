"""The bus: topics, messages, bytes and the Zenoh session."""
