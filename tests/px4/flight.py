"""One flight of real PX4s with real agents, judged by PX4's own truth; things that break in it."""

from __future__ import annotations

import contextlib
import itertools
import json
import math
import os
import re
import signal
import subprocess
import sys
import time
import tomllib
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from groundstation.processes.free_ports import toml_text, with_free_ports
from onboard.autopilot import Version
from onboard.config.earth import latitude_longitude_deg
from onboard.config.fleet import FleetConfig, Vehicle, fleet_from_mapping
from onboard.config.pair_separation import separations_m
from onboard.px4.required_params import FAILSAFES, all_params
from sitl.px4.parameters import DEFAULTS
from tests.px4.build import Px4Build, Px4s, die_with_parent, free_instances

_ROOT = Path(__file__).parents[2]
_READY_S = 60.0
_FLIGHT_S = 180.0
_DOWN_S = 60.0
_GROUND_LOST_S = 10.0
_AIRBORNE_M = 0.10
_DOWN_M = 0.15
_STILL_M_S = 0.10
_WATCH_S = 1.0
# else the simulated battery loses half of its charge in a minute, and a pause ends at once
_BATTERY = {"SIM_BAT_DRAIN": 1800.0}


def fleet_of(
    count: int, folder: Path, instances: list[int], version: Version | None
) -> FleetConfig:
    """Write a fleet file for so many PX4s: three as in configs/fleets/sih.toml, or more of its
    vehicles in a ring.

    The type is the one that was identified with the version and the same gains.
    """
    data = tomllib.loads((_ROOT / "configs/fleets/sih.toml").read_text(encoding="utf-8"))
    data["defaults"]["type"] = "sih118quick" if version == (1, 18) else "sih"
    first = next(iter(data["vehicles"].values()))
    starts = [table["start_enu_m"] for table in data["vehicles"].values()]
    if count > len(starts):
        angles = [2.0 * math.pi * index / count for index in range(count)]
        ring = [[round(2.2 * math.cos(a), 3), round(2.2 * math.sin(a), 3), 0.0] for a in angles]
        starts = ring
        names = [f"mav{index}" for index in range(count)]
        opposite = ring[count // 2 :] + ring[: count // 2]
        data["formations"] = {
            "ring": dict(zip(names, ring, strict=True)),
            "opposite": dict(zip(names, opposite, strict=True)),
        }
        data["fleet"]["geofence_m"] = {"x": [-6.0, 6.0], "y": [-6.0, 6.0], "z": [0.0, 3.0]}
    data["vehicles"] = {
        f"mav{index}": {
            **first,
            "start_enu_m": starts[index],
            "mocap_body": f"mav{index}",
            "system_id": number + 1,
        }
        for index, number in enumerate(instances)
    }
    for index, table in enumerate(data["vehicles"].values()):
        table.update(
            agent=f"tcp/127.0.0.1:{7460 + index}", autopilot=f"udpin://127.0.0.1:{14540 + index}"
        )
        table.update(direct=f"udpout://127.0.0.1:{18570 + index}")
    data["fleet"]["ground_lost_land_s"] = _GROUND_LOST_S
    return written(data, folder, instances)


def written(data: dict[str, Any], folder: Path, instances: list[int]) -> FleetConfig:
    """Write a fleet file with ports that are free, except for PX4's, which are its own."""
    data = with_free_ports(data, fleet_from_mapping(data))
    for table, number in zip(data["vehicles"].values(), instances, strict=True):
        table["autopilot"] = f"udpin://127.0.0.1:{14540 + number}"
        table["direct"] = f"udpout://127.0.0.1:{18570 + number}"
    path = folder / "fleet.toml"
    path.write_text(toml_text(data), encoding="utf-8")
    return fleet_from_mapping(data, path=str(path), text=path.read_text(encoding="utf-8"))


@dataclass(slots=True)
class Flight:
    """A flight under way: its processes, its files, and what was measured."""

    fleet: FleetConfig
    folder: Path
    version: Version | None  # of the PX4s
    px4s: Px4s
    agents: Mapping[str, subprocess.Popen[bytes]]
    wind: Mapping[str, float] = field(default_factory=dict)  # parameters of PX4's simulator
    ground: subprocess.Popen[bytes] | None = None
    lost: set[str] = field(default_factory=set)  # vehicles whose PX4 is gone: they cannot come down
    fault_s: float = math.nan  # monotonic time of the fault

    @property
    def log(self) -> str:
        """All that the ground has printed."""
        return (self.folder / "fly.log").read_text(encoding="utf-8", errors="replace")

    def px4(self, name: str) -> subprocess.Popen[bytes]:
        """The process of a vehicle's PX4."""
        return self.px4s.processes[self._number(name)]

    def start_px4(self, name: str, place_enu_m: tuple[float, float] | None = None) -> None:
        """Start the PX4 of a vehicle, with what the fleet needs.

        Args:
            name: of the vehicle.
            place_enu_m: where it starts, in a fleet with an origin on Earth; None: on its spot.
        """
        vehicle = self.fleet.vehicles[name]
        params = _params_to_set(self.fleet, vehicle, self.version)
        params.update(_BATTERY)
        params.update(self.wind)

        place_deg = None
        origin = self.fleet.fleet.global_origin
        if origin is not None:
            east, north = place_enu_m or vehicle.start_enu_m[:2]
            place_deg = latitude_longitude_deg(origin, east_m=east, north_m=north)
        self.px4s.start(self._number(name), params, place_deg)

    def stop_px4(self, name: str) -> None:
        """Stop the PX4 of a vehicle, as one who takes its battery out."""
        self.px4s.stop(self._number(name))

    def _number(self, name: str) -> int:
        return self.fleet.vehicles[name].system_id - 1

    def cut_poses(self, seconds: float = math.inf) -> None:
        """Withhold the poses of all vehicles, for a while or for good."""
        (self.folder / "cut").touch()
        if math.isfinite(seconds):
            time.sleep(seconds)
            (self.folder / "cut").unlink()

    def turn_cameras(self, gap_s: float) -> None:
        """Let the cameras of all vehicles begin their frames anew, turned, after a gap."""
        if gap_s > 0.0:
            (self.folder / "cut").touch()
            time.sleep(gap_s)
        (self.folder / "turned").touch()
        (self.folder / "cut").unlink(missing_ok=True)

    def freeze_cameras(self) -> None:
        """Let the cameras of all vehicles repeat what they have sent last."""
        (self.folder / "frozen").touch()

    def stall_poses(self, seconds: float) -> None:
        """Keep the poses of all vehicles back for a while; then they come late, all at once."""
        (self.folder / "stall").touch()
        time.sleep(seconds)
        (self.folder / "stall").unlink()

    def tracks(self) -> dict[str, NDArray[np.float64]]:
        """Per vehicle an array (T, 7): seconds, position and velocity in fleet ENU, PX4's truth."""
        rows: dict[str, list[list[float]]] = {name: [] for name in self.fleet.enabled_names}
        for line in (self.folder / "truth.jsonl").read_text(encoding="utf-8").splitlines():
            with contextlib.suppress(json.JSONDecodeError):  # the last line may be cut
                name, *values = json.loads(line)
                rows[name].append(values)
        return {name: np.array(values) for name, values in rows.items()}

    def closest_m(self) -> float:
        """Smallest separation of two centres while one of the two flies, over the whole flight.

        It is their horizontal distance if the fleet file has no vertical separation.
        """
        height_share = self.fleet.fleet.height_share
        closest = math.inf
        for a, b in itertools.combinations(self.tracks().values(), 2):
            t = np.arange(max(a[0, 0], b[0, 0]), min(a[-1, 0], b[-1, 0]), 0.02)
            first, second = (
                [np.interp(t, one[:, 0], one[:, i]) for i in (1, 2, 3)] for one in (a, b)
            )
            is_flying = np.maximum(first[2], second[2]) > _AIRBORNE_M
            offset_m = np.stack(first, axis=-1) - np.stack(second, axis=-1)
            apart_m = separations_m(offset_m, height_share)[is_flying]
            closest = min(closest, float(apart_m.min(initial=math.inf)))
        return closest

    def down_after_s(self) -> float:
        """Seconds from the fault until all that can have come down to rest; infinite when one is in
        the air.
        """
        latest_s = self.fault_s
        for name, track in self.tracks().items():
            if name in self.lost:
                continue
            in_air = (track[:, 3] > _DOWN_M) | (np.linalg.norm(track[:, 4:7], axis=1) > _STILL_M_S)
            if in_air[-25:].any():
                return math.inf
            latest_s = max(latest_s, float(track[in_air, 0].max(initial=self.fault_s)))
        return latest_s - self.fault_s

    def wait_until_down(self) -> None:
        """Wait until the ground has ended or is stopped, and everything is down."""
        end_s = time.monotonic() + _DOWN_S
        while time.monotonic() < end_s and not math.isfinite(self.down_after_s()):
            time.sleep(_WATCH_S)


FleetFile = Callable[[int, Path, list[int], Version | None], FleetConfig]


@contextlib.contextmanager
def standing(
    build: Px4Build,
    count: int,
    folder: Path,
    fleet_file: FleetFile = fleet_of,
    *,
    wind: Mapping[str, float] | None = None,
    switched_off: Sequence[str] = (),
) -> Iterator[Flight]:
    """PX4s, poses and agents that are ready, without a ground; all ended with the block.

    Args:
        build: of the PX4s.
        count: of vehicles.
        folder: for the files of the flight.
        fleet_file: writes the fleet file. PX4s start on its spots where it has an origin on Earth.
        wind: parameters of PX4's simulator that make wind.
        switched_off: vehicles whose PX4 is not started; their agents run.
    """
    fleet = fleet_file(count, folder, free_instances(count), build.version)
    agents: dict[str, subprocess.Popen[bytes]] = {}
    with contextlib.ExitStack() as stack:
        px4s = stack.enter_context(Px4s(build, folder))
        flight = Flight(fleet, folder, build.version, px4s, agents, wind or {})
        begun = [name for name in fleet.enabled_names if name not in switched_off]
        for name in begun:
            flight.start_px4(name)

        stack.enter_context(_python(folder, "poses", "tests.px4.poses", fleet.path, str(folder)))
        words = ("--fleet", fleet.path, "--realtime", "--vehicle")
        for name in fleet.enabled_names:
            agents[name] = stack.enter_context(_python(folder, name, "onboard", *words, name))
        _wait(
            lambda: all(f"agent {name}: ready" in _log(folder, name) for name in begun),
            _READY_S,
            lambda: _logs(folder),
        )
        yield flight


@contextlib.contextmanager
def flying(
    build: Px4Build,
    count: int,
    folder: Path,
    mission: str,
    fleet_file: FleetFile = fleet_of,
    wind: Mapping[str, float] | None = None,
) -> Iterator[Flight]:
    """PX4s, poses, agents that are ready, and a ground that has begun a mission; all ended with the
    block.

    Args:
        build: of the PX4s.
        count: of vehicles.
        folder: for the files of the flight.
        mission: the text of the mission's file.
        fleet_file: writes the fleet file. PX4s start on its spots where it has an origin on Earth.
        wind: parameters of PX4's simulator that make wind.
    """
    (folder / "mission.toml").write_text(mission, encoding="utf-8")
    with standing(build, count, folder, fleet_file, wind=wind) as flight:
        fly = ("fly", str(folder / "mission.toml"), "--fleet", flight.fleet.path, "--headless")
        record = ("--record", str(folder / "record"))
        with _python(folder, "fly", "groundstation", *fly, *record) as flight.ground:
            yield flight


def _params_to_set(
    fleet: FleetConfig, vehicle: Vehicle, version: Version | None
) -> dict[str, float | int]:
    """What the fleet needs, without those of PX4's failsafes that come as they have to be."""
    defaults: Mapping[str, float | int] = {}
    if version is not None:
        defaults = DEFAULTS[f"{version[0]}.{version[1]}"]

    of_failsafes = {demand.name for demand in FAILSAFES}
    params = {}
    for demand in all_params(fleet, vehicle, version):
        comes_so = demand.name in of_failsafes and demand.is_met(defaults.get(demand.name))
        if not demand.is_optional and not comes_so:
            params[demand.name] = demand.value
    return params


def break_in(flight: Flight, step: str, after_s: float, fault: Callable[[Flight], None]) -> None:
    """Wait until a step of the mission has begun and ``after_s`` more, then break something."""
    line = re.compile(rf"^ *[\d.]+ s  {step}\b", re.MULTILINE)
    _wait(lambda: line.search(flight.log) is not None, _FLIGHT_S, lambda: flight.log)
    time.sleep(after_s)
    flight.fault_s = time.monotonic()
    fault(flight)


def order(flight: Flight, *words: str) -> int:
    """Order something from a second ground; its exit status."""
    command = [sys.executable, "-m", "groundstation", "order", "--fleet", flight.fleet.path, *words]
    return subprocess.run(command, check=False, timeout=90.0).returncode


def end(flight: Flight) -> int:
    """Wait for the ground's verdict; its exit status."""
    assert flight.ground is not None
    return flight.ground.wait(_FLIGHT_S)


def told(flight: Flight, step: str, after_s: float) -> tuple[float, str]:
    """Seconds from a fault to the first warning that the operator read after it, and its sentence.

    Args:
        flight: with a ground that was there.
        step: during which the fault came.
        after_s: from the begin of that step.
    """
    begin = re.search(rf"^ *([\d.]+) s  {step}\b", flight.log, re.MULTILINE)
    assert begin is not None, flight.log
    fault_s = float(begin[1]) + after_s
    for time_s, sentence in re.findall(
        r"^ *([\d.]+) s    (\[\w+\] (?:warning|critical): .*)$", flight.log, re.MULTILINE
    ):
        if float(time_s) >= fault_s - 0.05:
            return float(time_s) - fault_s, sentence
    return math.inf, ""


def _wait(is_true: Callable[[], bool], timeout_s: float, explain: Callable[[], str]) -> None:
    end_s = time.monotonic() + timeout_s
    while not is_true():
        assert time.monotonic() < end_s, explain()
        time.sleep(0.05)


@contextlib.contextmanager
def _python(folder: Path, name: str, *words: str) -> Iterator[subprocess.Popen[bytes]]:
    """A Python program with its output in a file; interrupted, and then killed, with the block."""
    with (folder / f"{name}.log").open("wb") as log:
        process = subprocess.Popen(
            [sys.executable, "-m", *words],
            env={**os.environ, "PYTHONUNBUFFERED": "1"},
            cwd=_ROOT,
            stdin=subprocess.DEVNULL,
            stdout=log,
            stderr=subprocess.STDOUT,
            process_group=0,
            preexec_fn=die_with_parent,
        )
    try:
        yield process
    finally:
        if process.poll() is None:
            os.killpg(process.pid, signal.SIGCONT)
            os.killpg(process.pid, signal.SIGTERM)
            try:
                process.wait(5)
            except subprocess.TimeoutExpired:
                os.killpg(process.pid, signal.SIGKILL)
                process.wait()


def _log(folder: Path, name: str) -> str:
    path = folder / f"{name}.log"
    return path.read_text(encoding="utf-8", errors="replace") if path.exists() else ""


def _logs(folder: Path) -> str:
    return "\n".join(
        f"--- {log.name}\n{_log(folder, log.stem)[-2000:]}" for log in sorted(folder.glob("*.log"))
    )


def verdict(flight: Flight) -> dict[str, Any]:
    """The ground's verdict.json."""
    content: dict[str, Any] = json.loads(
        (flight.folder / "record/verdict.json").read_text(encoding="utf-8")
    )
    return content
