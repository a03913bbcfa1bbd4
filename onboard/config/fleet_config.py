"""The frozen values of a fleet file: ``[fleet]``, each vehicle, and the whole file.

docs/fleet-file.md is printed from the comments beside the fields.
"""

from __future__ import annotations

import hashlib
import math
import os
import re
from collections.abc import Iterable
from typing import Literal

import msgspec

from onboard.config import fences, obstacles
from onboard.config.areas import BELOW_FLOOR_M
from onboard.config.corrections import CorrectionsConfig
from onboard.config.earth import Origin as Origin
from onboard.config.endpoints import host_of
from onboard.config.formation_shape import FormationShape
from onboard.config.law import LawConfig
from onboard.config.law_import import OwnLaw, find_own_law
from onboard.config.mocap import MocapConfig
from onboard.config.people import Person, body_of
from onboard.config.radio import RadioConfig
from onboard.config.sitl import SitlProfile
from onboard.config.toml_reading import ConfigError
from onboard.tuples import Xyz

PX4_VERSIONS = ("1.16", "1.17", "1.18")  # versions of PX4 that Covey was measured with

_TICKS_PER_S = 50  # rate of the control loop
_FUSES_HEADING = 8  # bit of EKF2_EV_CTRL
HEADING_NOISE_RAD = 0.1  # EKF2_EVA_NOISE of a vehicle by vision, unless px4_params names another
_MAX_QUOTED = 40  # characters of a wrong word that a sentence repeats
# height on top of the vertical separation for hovering above each other, because the law acts 0.20
# m early and vehicles hold their heights to about 0.05 m
_STACKING_MARGIN_M = 0.25
_ROUNDING_CM = 1e-6  # heights in sentences are rounded up, but not because of a rounding error
# on top of the design distance for hovering side by side; vehicles reach closer slots late or never
# (measured)
_PARKING_MARGIN_M = 0.10


class Geofence(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Box in fleet ENU; each axis is (low, high) in metres."""

    x: tuple[float, float]  # east, [low, high] in metres
    y: tuple[float, float]  # north, [low, high] in metres
    z: tuple[float, float]  # up, [low, high] in metres

    def contains(self, position_enu_m: Xyz) -> bool:
        """Whether a point lies in the box.

        Args:
            position_enu_m: the point.
        Returns:
            True for a point in the box, and up to 0.5 m below its floor.
        """
        x, y, z = position_enu_m
        west, east = self.x
        south, north = self.y
        floor, top = self.z
        is_in_plan = west <= x <= east and south <= y <= north
        return is_in_plan and floor - BELOW_FLOOR_M <= z <= top

    def nearest_inside(self, position_enu_m: Xyz, inside_m: float) -> Xyz:
        """Return the nearest point that keeps a distance from every wall, on the inside.

        Args:
            position_enu_m: any point.
            inside_m: distance to the walls [m].
        """
        x, y, z = position_enu_m
        west, east = self.x
        south, north = self.y
        floor, top = self.z
        return (
            min(max(x, west + inside_m), east - inside_m),
            min(max(y, south + inside_m), north - inside_m),
            min(max(z, floor + inside_m), top - inside_m),
        )


class FleetSection(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """``[fleet]``: values for all vehicles."""

    name: str  # part of the keys on the bus; must differ between the fleets of a network
    geofence_m: Geofence  # the box that no vehicle leaves; the three keys below
    # "mocap", or the frame's origin on Earth: the three keys below
    origin: Literal["mocap"] | Origin = "mocap"
    safety_distance_m: float = 0.80  # horizontal distance between two centres that the law promises
    # or this difference of their heights; none: no vehicle flies above another
    vertical_separation_m: float | None = None
    body_diameter_m: float = 0.50  # from propeller tip to propeller tip
    # standard deviation per axis of a vehicle's position from its start_enu_m: how precisely people
    # place it. With it, preflight detects a turned or shifted frame.
    placing_m: float = 0.05
    battery_warning_pct: float = 30.0  # below it, the console warns
    battery_land_pct: float = 20.0  # below it, a vehicle lands by itself
    # if an agent does not answer within this time, kill goes directly to PX4, and land is sent
    # again
    direct_command_timeout_s: float = 0.3
    # a vehicle that receives nothing on the bus holds, and then lands after this time
    bus_lost_land_s: float = 5.0
    # flying vehicles land if no ground that may give orders has been on the bus for this time
    ground_lost_land_s: float = 60.0
    # largest mean wind in which vehicles fly; by default only each vehicle's own limit counts
    max_wind_m_s: float | None = None
    # folder of the keys, beside this file (not beside a link to it) or below it, of A-Z a-z 0-9 _ .
    # / - without ..; docs/keys.md
    keys: str = "keys"
    # endpoints of routers, quic/HOST:PORT; nodes connect to the first that answers: docs/network.md
    routers: tuple[str, ...] = ()
    # where covey sitl listens on the bus; by default the port below the lowest agent's
    simulator: str | None = None

    @property
    def height_share(self) -> float:
        """Metres of separation that one metre of height counts for; 0: heights do not count."""
        if self.vertical_separation_m is None:
            return 0.0
        return self.safety_distance_m / self.vertical_separation_m

    @property
    def global_origin(self) -> Origin | None:
        """Position of the fleet frame on Earth; None if the file has none."""
        if isinstance(self.origin, Origin):
            return self.origin
        return None


class Vehicle(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """One vehicle with its type's and the defaults' values merged in."""

    name: str
    index: int
    system_id: int  # MAV_SYS_ID of its PX4
    start_enu_m: Xyz  # where it stands before take-off: east, north, up in the fleet frame
    agent: str  # its agent on the bus: quic/HOST:PORT of the companion computer; tcp/ without keys
    # PX4 as the companion sees it: udpin://HOST:PORT, udpout://HOST:PORT or serial://DEVICE:BAUD
    autopilot: str
    # PX4 as the ground reaches it without the companion: udpout://HOST:PORT, udpin://HOST:PORT or
    # tcp://HOST:PORT; HOST is a name or an IPv4 address
    direct: str | None = None
    mocap_body: str | None = None  # name of its body in the mocap; the vehicle's own by default
    type: str = ""  # table [types.NAME] with values for keys that the vehicle does not set
    # false: it does not take part in flights; "scan": it takes part if it answers, but the fleet
    # does not wait for it
    enabled: bool | Literal["scan"] = True
    # true: covey sitl simulates its PX4 and poses, beside real vehicles: docs/mixed-reality.md
    emulated: bool = False
    mass_kg: float = 1.0  # with battery
    # hover throttle, 0 to 1; starting value: MPC_THR_HOVER of a tuned PX4, or 0.5
    hover_thrust_frac: float = 0.5
    attitude_delay_s: float = 0.04  # dead time of its attitude; starting value 0.04
    attitude_wn_rad_s: float = 11.0  # natural frequency of its attitude; starting value 9, cautious
    attitude_zeta: float = 0.6  # damping of its attitude; starting value 0.7
    # deceleration for each m/s through the air; 0: not known; starting value 0.3
    drag_1_s: float = 0.0
    # hover time on a full battery; with it, covey check checks a mission's length
    hover_time_s: float | None = None
    max_tilt_deg: float = 25.0  # of all manoeuvres
    max_speed_m_s: float = 1.0  # of all moves
    # of all moves; vertically also at most 2.25 m/s², and 0.36 of the lift reserve
    max_acceleration_m_s2: float = 1.5
    # largest mean wind in which it flies; by default from tilt, thrust and drag: docs/wind.md
    max_wind_m_s: float | None = None
    # true: it uses the mocap's poses, and does not take off without them; false: it uses PX4's own
    # position
    mocap_required: bool = True
    # source of PX4's own position, without a mocap
    px4_position: Literal["gps", "vision"] = "gps"
    # version of its PX4, for which its attitude response was identified; the emulator imitates it
    px4_version: Literal["1.16", "1.17", "1.18"] = "1.17"
    # its MAVLink is signed with the key keys/NAME.mavlink.key (PX4 v1.18 and later):
    # docs/mavlink-signing.md
    mavlink_signing: bool = False
    # parameters that its PX4 must have beyond the built-in ones: NAME = value
    px4_params: dict[str, float | int] = {}
    sitl: SitlProfile = SitlProfile()  # values of the emulator only: the table below

    @property
    def host(self) -> str:
        """Name or address of the computer that runs the agent."""
        return host_of(self.agent)

    @property
    def body(self) -> str | None:
        """Name of this vehicle's mocap body; None if it flies without a mocap."""
        if self.mocap_body:
            return self.mocap_body
        if self.mocap_required:
            return self.name
        return None

    @property
    def flies_by_satellites(self) -> bool:
        """Whether it flies on PX4's own position, by satellites."""
        return not self.mocap_required and self.px4_position == "gps"

    @property
    def flies_by_vision(self) -> bool:
        """Whether it flies on PX4's own position, by vision."""
        return not self.mocap_required and self.px4_position == "vision"

    @property
    def has_heading_by_vision(self) -> bool:
        """Whether its PX4 takes the heading, too, from a camera, and so from no compass."""
        fused = int(self.px4_params.get("EKF2_EV_CTRL", _FUSES_HEADING))
        return self.flies_by_vision and bool(fused & _FUSES_HEADING)

    @property
    def lag_s(self) -> float:
        """Time over which the law predicts: dead time plus 2 zeta / wn of the attitude response.

        A second-order response follows a ramp with a delay of 2 zeta / wn.
        """
        return self.attitude_delay_s + 2.0 * self.attitude_zeta / self.attitude_wn_rad_s


class FleetConfig(msgspec.Struct, frozen=True):
    """A whole fleet file, with all values resolved."""

    path: str  # path of the file
    fleet: FleetSection
    law: LawConfig
    formations: dict[str, dict[str, Xyz]]  # formation -> vehicle -> its slot
    vehicles: dict[str, Vehicle]  # by name, in the order of the file
    text: str  # text of the file
    obstacles: tuple[obstacles.Obstacle, ...] = ()
    fences: tuple[fences.Fence, ...] = ()  # areas to stay in or out of, inside the box
    mocap: MocapConfig = MocapConfig()
    people: dict[str, Person] = {}  # persons with markers, by name
    # formations by shape; only the ground uses them, so they are not in the hash
    shapes: dict[str, FormationShape] = {}
    # the radio channel; only its expected lateness is in the hash
    radio: RadioConfig | None = None
    # RTK corrections; only the values that agents use in their decisions are in the hash
    corrections: CorrectionsConfig | None = None
    own_law: OwnLaw | None = None  # the user's own law named by law.name; None for Covey's laws

    @property
    def namespace(self) -> str:
        """Key prefix on the bus."""
        return f"covey/{self.fleet.name}"

    def with_law(self, name: str | None, *, named_by: str | None = None) -> FleetConfig:
        """Return the same fleet with another law; None keeps the file's law.

        Args:
            name: name of the law.
            named_by: the option whose value the name is, for messages; None: this fleet file.
        Raises:
            ConfigError: There is no such law.
        """
        if name is None:
            return self
        law = msgspec.structs.replace(self.law, name=name)
        return msgspec.structs.replace(self, law=law).with_own_law(named_by=named_by)

    def with_own_law(self, *, named_by: str | None = None) -> FleetConfig:
        """Return the same fleet with the law that its file names.

        A user's own law is found and hashed, but not imported: see :meth:`import_law`.

        Args:
            named_by: see :meth:`with_law`.
        Raises:
            ConfigError: There is no such law.
        """
        if named_by is None:
            named_by = f"{self.path}: 'law.name'"
        own_law: OwnLaw | None = None
        if self.law.is_own:
            folder = os.path.join(os.path.dirname(os.path.abspath(self.path)), self.law.folder)
            own_law = find_own_law(self.law.name, (folder, os.getcwd()), named_by)
        return msgspec.structs.replace(self, own_law=own_law)

    def import_law(self) -> None:
        """Import the user's own law, if there is one; this runs its code.

        It is called before a vehicle flies with the law, so that a mistake is reported in words.

        Raises:
            ConfigError: The law cannot be imported, or is not a law.
        """
        if self.own_law is not None:
            self.own_law.load()

    @property
    def config_hash(self) -> str:
        """Hash of all values that must be equal on all vehicles.

        The preflight check refuses a take-off if another vehicle has a different hash.
        """
        # the folders of keys and laws, and the nearest router, may differ between computers
        fleet = msgspec.structs.replace(self.fleet, keys="keys", routers=())
        law = msgspec.structs.replace(self.law, folder=".")
        law_values = msgspec.json.decode(msgspec.json.encode(law))
        if law.paper_margin_m == 0.0:  # so that files without it keep the hash of earlier versions
            del law_values["paper_margin_m"]
        # in a rehearsal all are emulated
        vehicles = {
            name: msgspec.structs.replace(vehicle, emulated=False)
            for name, vehicle in self.vehicles.items()
        }
        source = ""
        if self.own_law is not None:
            source = self.own_law.source_hash

        # only the radio's lateness counts, because it determines when a neighbour counts as silent
        late_s = self.expected_radio.lateness_s

        parts = [
            fleet,
            msgspec.Raw(msgspec.json.encode(law_values)),
            source,
            self.formations,
            vehicles,
            self.obstacles,
            self.mocap,
            late_s,
        ]
        # added only if present, so that files without them keep the hash of earlier versions
        if self.fences:
            parts.append(self.fences)
        if self.people:
            parts.append(self.people)
        if self.corrections is not None:
            parts.append(self.corrections.judged)
        values = msgspec.json.encode(parts, order="deterministic")
        return hashlib.sha256(values).hexdigest()[:12]

    def takes_corrections(self, vehicle: Vehicle) -> bool:
        """Whether the fleet has corrections, and the vehicle uses satellite positioning."""
        return self.corrections is not None and vehicle.flies_by_satellites

    def begins_on_its_spot(self, vehicle: Vehicle) -> bool:
        """Whether the vehicle's frame begins on its take-off spot, wherever it was put.

        PX4 does not know where on Earth its frame begins if it flies by vision, and the fleet does
        not know it without an origin.
        """
        has_own_frame = self.fleet.global_origin is None or vehicle.flies_by_vision
        return not vehicle.mocap_required and has_own_frame

    @property
    def expected_radio(self) -> RadioConfig:
        """``[radio]``, or its defaults if the file has none."""
        if self.radio is None:
            return RadioConfig()
        return self.radio

    @property
    def state_ticks(self) -> int:
        """Number of ticks between two states of a vehicle for its near neighbours."""
        if self.radio is None:
            return 1
        return _TICKS_PER_S // self.radio.states_hz

    @property
    def has_keys(self) -> bool:
        """Whether the nodes of the bus authenticate with keys. The agents' endpoints show this."""
        return any(
            vehicle.agent.startswith(("quic/", "tls/")) for vehicle in self.vehicles.values()
        )

    @property
    def keys_folder(self) -> str:
        """Folder of the bus's keys, also if the path of the fleet file is a link to it."""
        return os.path.join(os.path.dirname(os.path.realpath(self.path)), self.fleet.keys)

    @property
    def enabled_names(self) -> tuple[str, ...]:
        """Vehicles that take part, in the order of the file."""
        return tuple(
            name for name, vehicle in self.vehicles.items() if vehicle.enabled is not False
        )

    @property
    def numbers(self) -> dict[str, int]:
        """Number of each vehicle in the file, from 0. :meth:`select` accepts it like the name."""
        return {name: number for number, name in enumerate(self.vehicles)}

    @property
    def labels(self) -> dict[str, str]:
        """Short text for each vehicle, by which :meth:`select` selects it.

        It is the number; in a fleet with numbers as names, where a number means a name, the name.
        """
        if any(name.isdecimal() for name in self.vehicles):
            return {name: name for name in self.vehicles}
        return {name: str(number) for name, number in self.numbers.items()}

    @property
    def people_bodies(self) -> dict[str, str]:
        """Mocap body of each person, by name."""
        return {name: body_of(name, person) for name, person in self.people.items()}

    @property
    def simulator_endpoint(self) -> str:
        """Endpoint at which an emulator listens on the bus.

        By default it is the port below the lowest agent's.
        """
        if self.fleet.simulator:
            return self.fleet.simulator

        ports = []
        for vehicle in self.vehicles.values():
            _, _, port = vehicle.agent.rpartition(":")
            ports.append(int(port))
        scheme = "quic" if self.has_keys else "tcp"
        return f"{scheme}/127.0.0.1:{min(ports) - 1}"

    @property
    def emulated_names(self) -> tuple[str, ...]:
        """Vehicles that take part and are marked as emulated, in the order of the file."""
        return tuple(name for name in self.enabled_names if self.vehicles[name].emulated)

    @property
    def pose_endpoints(self) -> tuple[str, str]:
        """Endpoints of the nodes that publish poses and true positions.

        The first one is that of a mocap relay, or of the emulator of a whole fleet. If only a part
        of the fleet is emulated, the emulator uses the port below.
        """
        host, _, port = self.simulator_endpoint.rpartition(":")
        return self.simulator_endpoint, f"{host}:{int(port) - 1}"

    def select(
        self, vehicles: str | Iterable[str] | None, exclude: str | None = None
    ) -> tuple[str, ...]:
        """Select vehicles by name or by index in the file.

        Where vehicles are named by numbers, a number means the name: ``1-3`` means the vehicles
        that are named 1, 2 and 3.

        Args:
            vehicles: ``a,b``, ``0-2`` or ``all``, or a list of these. None: all enabled vehicles.
            exclude: vehicles to leave out, in the same form.
        Returns:
            The names without duplicates, in the given order.
        Raises:
            ConfigError: There is no vehicle with a given name or index, a span is not clear, or a
                list or text is empty.
        """
        if vehicles is None:
            vehicles = "all"
        if not isinstance(vehicles, str):
            vehicles = ",".join(vehicles)
        if not vehicles.strip():
            raise ConfigError(
                'the list of vehicles is empty. Name one, or write "all" for all vehicles.'
            )
        selected = self._names(vehicles)

        excluded: tuple[str, ...] = ()
        if exclude:
            excluded = self._names(exclude)

        return tuple(name for name in selected if name not in excluded)

    def _names(self, text: str) -> tuple[str, ...]:
        """Return the names of a selection such as ``mav0,3-5``, without duplicates."""
        names: list[str] = []
        for piece in text.split(","):
            part = piece.strip()
            if part in self.vehicles:
                names.append(part)
            elif part == "all":
                names.extend(self.enabled_names)
            else:
                names.extend(self._names_of_span(part))
        return tuple(dict.fromkeys(names))

    def _names_of_span(self, part: str) -> list[str]:
        """Return the names of a number, ``3``, or of several, ``3-5``.

        The numbers are names if vehicles have such names, or else indices.
        """
        order = list(self.vehicles)
        span = re.fullmatch(r"(?P<first>\d{1,6})(?:-(?P<last>\d{1,6}))?", part)
        if span is None:
            raise ConfigError(
                f"'{part[:_MAX_QUOTED]}' is not a vehicle of fleet '{self.fleet.name}': it has "
                f"{', '.join(order)}."
            )

        first = int(span["first"])
        last = first
        if span["last"]:
            last = int(span["last"])

        named = [name for name in order if name.isdecimal() and first <= int(name) <= last]
        if named:
            named.sort(key=int)
            if [int(name) for name in named] != list(range(first, last + 1)):
                raise ConfigError(
                    f"'{part}' is not clear: of its numbers, the names of vehicles are "
                    f"{', '.join(named)}. Name each vehicle, with commas between them."
                )
            return named

        if first > last or last >= len(order):
            raise ConfigError(
                f"'{part}' selects no vehicle: vehicles are counted from 0 to {len(order) - 1}, "
                "lower first."
            )
        return order[first : last + 1]


def above_words(distance_m: float, height_share: float) -> str:
    """Return in words the difference in height that replaces a horizontal distance.

    Args:
        distance_m: the horizontal distance.
        height_share: from :func:`parking_height_share`.
    Returns:
        The end of a sentence; empty if the fleet has no vertical separation.
    """
    if height_share <= 0.0:
        return ""
    height_cm = math.ceil(100.0 * distance_m / height_share - _ROUNDING_CM)
    return f", or {height_cm / 100.0:.2f} m above each other"


def parking_height_share(config: FleetConfig, accuracy_m: float = 0.0) -> float:
    """Return how many metres of :func:`parking_distance_m` one metre of height counts for.

    Args:
        config: the fleet.
        accuracy_m: height by which the law widens the vertical separation because of the
            accuracy of the vehicles' positions.
    """
    vertical_m = config.fleet.vertical_separation_m
    if vertical_m is None:
        return 0.0
    return parking_distance_m(config) / (vertical_m + _STACKING_MARGIN_M + accuracy_m)


def parking_distance_m(config: FleetConfig) -> float:
    """Return the smallest spacing at which two vehicles can hover under the configured law.

    For the paper's law it is sqrt(d_inf^2 + d_inf v_perp / kappa_3), because equation (8) does not
    allow a closer hover. For Covey's law it is the design distance plus 0.10 m. Without a law it is
    the diameter of a body.

    Args:
        config: the fleet.
    Returns:
        Horizontal distance [m] between centres.
    """
    law = config.law
    d_inf = config.fleet.safety_distance_m

    if law.built_in == "paper":
        d_inf += law.paper_margin_m
        return math.sqrt(d_inf**2 + d_inf * law.paper_v_perp_m_s / law.paper_kappa_3_1_s)
    if law.built_in == "off":
        return config.fleet.body_diameter_m

    longest_lag_s = max((vehicle.lag_s for vehicle in config.vehicles.values()), default=0.0)
    return d_inf + law.margin_m(longest_lag_s) + _PARKING_MARGIN_M
