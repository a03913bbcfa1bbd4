"""Facts in which the emulator differs from PX4, by name, and why; everything else has to agree."""

from __future__ import annotations

DIFFERENCES: dict[str, str] = {}

# `covey sitl-check` against a real PX4 of another version (main of February 2025, between v1.15 and v1.16; SITL, SIH):
# what it does that v1.16.0 was measured not to. Agents have to live with either.
OTHER_VERSION: dict[str, str] = {
    "mode.two-acks": "one acknowledgement, the real one",
    "offboard.again": "one acknowledgement, the real one",
    "offboard.refused": "TEMPORARILY_REJECTED alone",
    "offboard.refused-text": "`Switching to Offboard is currently not available`",
    "offboard.cut-disarm": "6.8 s",
    "text.denied": "cut off after 50 characters",
    "text.chunks": "1",
    "setpoint.steep-text": "without the tabulator at its end",
    "battery.low-mode": "AUTO.LOITER: it leaves OFFBOARD at 15 % already",
    "battery.critical-text": "not said",
    "battery.critical-at": "not said",
    "battery.land-after": "not seen, since nothing was said before",
    "battery.voltage": "not linear in the percentage near empty",
}
