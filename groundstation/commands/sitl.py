"""``covey sitl``: emulated PX4s for a fleet file.

Examples:
  covey sitl --fleet configs/fleets/paper.toml
  covey sitl --fleet fleet.toml --fault 'mav1 motor_dead at=20 motor=2' --wind-m-s 3,0
  covey sitl --fleet fleet.toml --px4 1.18
  covey sitl --faults

The emulator has arming, PX4's modes, offboard, telemetry, parameters, signing
and losses. It answers UNSUPPORTED to missions, fences, rally points,
calibration, orbit and gimbal. It has no follow-me and no shell.
docs/emulator.md lists every command and message.

Exit status: 0 ended by an interrupt; 2 wrong input or a port in use, nothing was emulated.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Annotated, Literal

from cyclopts import Parameter

from groundstation.commands.parameters import FleetFile, Names
from groundstation.flights.simulation_settings import wind_of
from onboard.config.fleet import ConfigError, FleetConfig, load_fleet
from onboard.exit_status import EXIT_OK
from sitl.emulator.emulator import Environment
from sitl.emulator.mocap import MocapSettings
from sitl.faults import catalogue
from sitl.faults.catalogue import FaultError
from sitl.mavlink.endpoints import GROUND_STATION, Address, StartError, ground_port_of, station_of
from sitl.physics.wind import WindSettings
from sitl.physics.world import SpawnError
from sitl.server import Server, run, simulator_bus

_LARGEST = 30.0  # largest wind, gusts and scales
# option -> its lowest and its highest value
_BOUNDS = {
    "mocap-noise-m": (0.0, 10.0),
    "mocap-latency-s": (0.0, 10.0),
    "mocap-dropouts-per-s": (0.0, 1000.0),
    "mocap-dropout-s": (0.0, 3600.0),
    "truth-offset-m": (-1e6, 1e6),
    "ftp-dies-after-kb": (0, 1_000_000_000),
}


def sitl(
    *,
    fleet: FleetFile | None = None,
    vehicles: Names | None = None,
    exclude: Names | None = None,
    seed: int = 0,
    mocap_noise_m: float = 0.003,
    mocap_latency_s: float = 0.02,
    mocap_dropouts_per_s: float = 0.0,
    mocap_dropout_s: float = 0.1,
    no_bus: bool = False,
    gcs: Annotated[str | None, Parameter(metavar="HOST:PORT")] = None,
    no_gcs: bool = False,
    fault: Annotated[tuple[str, ...], Parameter(metavar="LINE")] = (),
    faults: bool = False,
    wind_m_s: Annotated[str, Parameter(metavar="EAST,NORTH", allow_leading_hyphen=True)] = "0,0",
    gust_m_s: float = 0.0,
    gust_s: float = 1.0,
    common_gusts: bool = False,
    common_errors: bool = False,
    error_scale: float = 1.0,
    truth_offset_m: float = 0.0,
    px4: Literal["1.16", "1.17", "1.18"] | None = None,
    ftp_dies_after_kb: int = 0,
) -> int:
    """Emulate the PX4s of a fleet, with their vehicles.

    Args:
        vehicles: names or indices, for instance mav0,mav2 or 0-1 (default: those with emulated =
            true, else all)
        exclude: vehicles to leave out
        seed: seed of all random numbers
        mocap_noise_m: standard deviation of the emulated motion capture
        mocap_latency_s: latency of the emulated motion capture
        mocap_dropouts_per_s: marker losses per body and second
        mocap_dropout_s: length of a marker loss
        no_bus: MAVLink only: no motion capture, no ground truth
        gcs: ground station that every vehicle streams to (default 127.0.0.1:14550 if the fleet uses
            PX4's ports)
        no_gcs: ground links answer only the program that speaks first
        fault: inject a fault, for instance 'mav1 motor_dead at=20 motor=2'; may be given several
            times
        faults: list the faults and their parameters, and exit
        wind_m_s: steady wind
        gust_m_s: standard deviation of gusts
        gust_s: correlation time of gusts
        common_gusts: all vehicles feel the same gusts
        common_errors: all estimates err alike, as instances of SIH do
        error_scale: size of the estimates' errors
        truth_offset_m: falsify the published truth by this much
        px4: version of PX4 to emulate (default: each vehicle's px4_version in the fleet file)
        ftp_dies_after_kb: stop each file transfer after this many kB without a message, as PX4
            v1.16 does after some seconds; 0 for never
    """
    if faults:
        print(catalogue.listing())
        return EXIT_OK

    if fleet is None:
        raise ConfigError("--fleet FILE is missing: the fleet whose PX4s are emulated.")
    if gcs is not None and no_gcs:
        raise ConfigError("--gcs and --no-gcs exclude each other. Give one of them.")

    config = load_fleet(fleet)
    names = _select(config, vehicles, exclude, has_poses=not no_bus)
    if not names:
        raise ConfigError("there is nothing to emulate: select at least one vehicle.")
    if seed < 0:
        raise ConfigError(f"--seed is {seed}; it must be 0 or more.")

    wind = WindSettings(
        mean_enu_m_s=(*wind_of(wind_m_s), 0.0),
        gust_std_m_s=gust_m_s,
        gust_time_s=gust_s,
        is_common=common_gusts,
    )
    if not all(0.0 <= value <= _LARGEST for value in (gust_m_s, gust_s, error_scale)):
        raise ConfigError("--gust-m-s, --gust-s and --error-scale must lie between 0 and 30.")

    _check_bounds(
        {
            "mocap-noise-m": mocap_noise_m,
            "mocap-latency-s": mocap_latency_s,
            "mocap-dropouts-per-s": mocap_dropouts_per_s,
            "mocap-dropout-s": mocap_dropout_s,
            "truth-offset-m": truth_offset_m,
            "ftp-dies-after-kb": ftp_dies_after_kb,
        }
    )
    mocap = MocapSettings(
        noise_m=mocap_noise_m,
        latency_s=mocap_latency_s,
        dropout_per_s=mocap_dropouts_per_s,
        dropout_s=mocap_dropout_s,
    )
    try:
        bus = None
        if not no_bus:
            bus = simulator_bus(config, is_partial=set(names) != set(config.enabled_names))
        server = Server(
            config,
            names,
            seed=seed,
            mocap=mocap,
            bus=bus,
            truth_offset_m=truth_offset_m,
            station=_station(config, names, gcs, is_silent=no_gcs),
            environment=Environment(wind, has_common_errors=common_errors, error_scale=error_scale),
            injected=[catalogue.parse(line) for line in fault],
            px4=px4,
            file_session_bytes=1000 * ftp_dies_after_kb,
        )
        run(server)
    except (StartError, SpawnError, FaultError) as error:
        raise ConfigError(str(error)) from None
    return EXIT_OK


def _check_bounds(values: Mapping[str, float]) -> None:
    """Refuse values of options outside their bounds.

    Args:
        values: option -> value.

    Raises:
        ConfigError: a value is outside.
    """
    for option, value in values.items():
        low, high = _BOUNDS[option]
        if not low <= value <= high:
            raise ConfigError(f"--{option} is {value:g}; it must lie between {low:g} and {high:g}.")


def _select(
    fleet: FleetConfig, vehicles: Names | None, exclude: str | None, *, has_poses: bool
) -> tuple[str, ...]:
    """Return the names of the vehicles to emulate.

    Raises:
        ConfigError: one of them is real, so that its body would get poses from two sources.
    """
    marked = fleet.emulated_names
    selection: Names | tuple[str, ...] | None = vehicles
    if vehicles is None and marked:
        selection = marked
    names = fleet.select(selection, exclude)

    real = []
    if marked:  # then all vehicles without the mark are real
        real = [name for name in names if name not in marked]
    if real and has_poses:
        raise ConfigError(
            f"{', '.join(real)}: real by {fleet.path}, which marks {', '.join(marked)} with"
            " emulated = true. A body may get its poses from one source only. Mark it too, or give"
            " --no-bus to emulate its PX4 without poses."
        )
    return names


def _station(
    fleet: FleetConfig, names: Sequence[str], endpoint: str | None, *, is_silent: bool
) -> Address | None:
    """Return the address of the ground station to which vehicles stream; None: they do not.

    The address is the given endpoint, or else PX4's default if the fleet uses PX4's ports.
    """
    if endpoint is not None:
        return station_of(endpoint)
    if is_silent:
        return None

    for name in names:
        uses_px4_port = ground_port_of(fleet.vehicles[name].autopilot) is not None
        if uses_px4_port:
            return GROUND_STATION
    return None
