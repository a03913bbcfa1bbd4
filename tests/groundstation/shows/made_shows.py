"""Small shows, written as Skybrush writes them."""

from __future__ import annotations

import json
import zipfile
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

Position = Callable[[float], tuple[float, float, float]]


def eased(share: float) -> float:
    """From 0 to 1, at rest at both ends."""
    u = min(max(share, 0.0), 1.0)
    return u**3 * (10 - 15 * u + 6 * u * u)


def up_and_down(
    x: Callable[[float], float], y: Callable[[float], float], seconds: float, top_m: float = 1.6
) -> Position:
    """A climb of three seconds, a way, and a descent of three seconds."""

    def at(t: float) -> tuple[float, float, float]:
        return x(t), y(t), top_m * eased(t / 3.0) * eased((seconds - t) / 3.0)

    return at


def trajectory(at: Position, seconds: float, step_s: float = 0.5) -> dict[str, Any]:
    """Cubic Bezier curves through a motion."""

    def speed(t: float) -> list[float]:
        low = max(t - 1e-4, 0.0)
        high = min(t + 1e-4, seconds)
        return [(b - a) / (high - low) for a, b in zip(at(low), at(high), strict=True)]

    points: list[Any] = [[0.0, list(at(0.0)), []]]
    for k in range(1, round(seconds / step_s) + 1):
        begin = (k - 1) * step_s
        end = k * step_s
        first = [p + v * step_s / 3 for p, v in zip(at(begin), speed(begin), strict=True)]
        second = [p - v * step_s / 3 for p, v in zip(at(end), speed(end), strict=True)]
        points.append([end, list(at(end)), [first, second]])
    return {"version": 1, "points": points, "takeoffTime": 0.0}


def write_skyc(
    path: Path,
    ways: Mapping[str, Position],
    seconds: float,
    *,
    show: Mapping[str, Any] | None = None,
    **settings: Any,
) -> Path:
    """A show with a trajectory for each drone in a member of its own."""
    drones = []
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, at in ways.items():
            archive.writestr(f"drones/{name}/trajectory.json", json.dumps(trajectory(at, seconds)))
            reference = {"$ref": f"./drones/{name}/trajectory.json#"}
            drones.append(
                {
                    "settings": {
                        "name": name,
                        "home": [*at(0.0)[:2], 0.0],
                        "trajectory": reference,
                        **settings,
                    }
                }
            )
        whole = {
            "version": 1,
            "environment": {"type": "indoor"},
            "swarm": {"drones": drones},
            **(show or {}),
        }
        archive.writestr("show.json", json.dumps(whole))
    return path


def line_of(
    count: int, seconds: float = 12.0, metres: float = 1.0, apart_m: float = 1.6
) -> dict[str, Position]:
    """Drones side by side that fly forwards together."""

    def way(k: int) -> Position:
        return up_and_down(
            lambda _: apart_m * k, lambda t: metres * eased((t - 3) / (seconds - 6)), seconds
        )

    return {f"D{k + 1}": way(k) for k in range(count)}


def crossing(seconds: float = 16.0, lead_s: float = 0.0) -> dict[str, Position]:
    """Two drones whose ways cross; one comes there that much earlier."""

    def share(t: float, early_s: float) -> float:
        return 4.0 * eased((t - 4 + early_s) / (seconds - 10)) - 2.0

    return {
        "east": up_and_down(lambda t: share(t, 0.0), lambda _: 0.0, seconds),
        "north": up_and_down(lambda _: 0.0, lambda t: share(t, lead_s), seconds),
    }


def csvs(folder: Path, ways: Sequence[Position], seconds: float) -> Path:
    """One CSV for each drone, with colours, times in milliseconds."""
    folder.mkdir()
    for k, at in enumerate(ways):
        lines = ["Time [msec],x [m],y [m],z [m],Red,Green,Blue"]
        for tick in range(round(seconds * 10) + 1):
            x, y, z = at(tick / 10)
            colour = "255,0,0" if tick < 50 else "0,0,255"
            lines.append(f"{100 * tick},{x:.3f},{y:.3f},{z:.3f},{colour}")
        (folder / f"Drone {k + 1}.csv").write_text("\n".join(lines), encoding="utf-8")
    return folder
