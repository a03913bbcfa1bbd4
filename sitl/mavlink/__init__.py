"""MAVLink of an emulated PX4: bytes, links, commands, streams."""
