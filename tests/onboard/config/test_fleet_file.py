"""Every wrong fleet file is a sentence that names file, key and remedy; every shipped one loads."""

import math
import tomllib
from pathlib import Path
from typing import Any

import pytest

from onboard.config.file_reading import check_values
from onboard.config.fleet import (
    ConfigError,
    FleetConfig,
    fleet_from_mapping,
    load_fleet,
    parking_distance_m,
)
from onboard.feasibility.fleet_checks import fleet_findings

FLEETS = sorted((Path(__file__).parents[3] / "configs" / "fleets").glob("*.toml"))
PAPER = next(path for path in FLEETS if path.stem == "paper")


def paper_data() -> dict[str, Any]:
    return tomllib.loads(PAPER.read_text())


def set_path(data: dict[str, Any], path: str, value: Any) -> None:
    *parents, last = path.split(".")
    for part in parents:
        data = data.setdefault(part, {})
    data[last] = value


def test_every_shipped_fleet_file_loads() -> None:
    for path in FLEETS:
        config = load_fleet(path)
        assert config.enabled_names, path
        assert config.namespace == f"covey/{config.fleet.name}", path


WRONG = [
    ("vehicles.mav1.autopilo", 1, "unknown key 'vehicles.mav1.autopilo'"),
    ("fleet.colour", "red", "unknown key 'fleet.colour'"),
    ("obstacles", [{"name": "pillar", "radius_m": 1.0}], "Known keys here: name, circle, polygon"),
    ("law.kapa", 1.0, "unknown key 'law.kapa'"),
    ("types.ardrone.wings", 2, "unknown key 'types.ardrone.wings'"),
    ("types.ardrone.mas_kg", 2, "Did you mean 'mass_kg'?"),
    ("types.ardrone.drag_1_s", 1e-320, "must be 0, where it is not known, or at least 1e-06."),
    ("laws", {}, "Did you mean 'law'?"),
    (
        "fleet.origin",
        "moon",
        "It may be mocap, or a table with latitude_deg, longitude_deg, altitude_m.",
    ),
    (
        "fleet.origin",
        {"latitude_deg": float("nan"), "longitude_deg": 8.5, "altitude_m": 440.0},
        "no place on Earth",
    ),
    (
        "fleet.origin",
        {"latitude_deg": 47.4, "longitude_deg": 8.5, "altitude_m": float("inf")},
        "'fleet.origin.altitude_m' is inf",
    ),
    ("law.uncooperative_margin_m", 20.0, "between 0 and 1"),
    ("types.ardrone.sitl.wings", 2, "unknown key 'types.ardrone.sitl.wings'"),
    ("types.ardrone.max_speed_m_s", -4.0, "'types.ardrone.max_speed_m_s' is -4.0"),
    ("types.ardrone.sitl.arm_m", 99.0, "'types.ardrone.sitl.arm_m' is 99.0"),
    ("types.ardrone.mocap_required", 7, "'types.ardrone.mocap_required'"),
    ("defaults.lights", "many", "'defaults.lights'"),
    ("defaults.type", [], "'defaults.type': it must be a text"),
    ("defaults.mass_kg", "heavy", "'defaults.mass_kg': it must be a number"),
    ("types.unused.wings", 2, "unknown key 'types.unused.wings'"),
    ("types.unused.type", "ardrone", "unknown key 'types.unused.type'"),
    ("types.unused.mass_kg", "heavy", "'types.unused.mass_kg': it must be a number, not a text"),
    ("types.unused.sitl", {"wings": 2}, "unknown key 'types.unused.sitl.wings'"),
    ("types.unused.px4_version", 1.17, "'types.unused.px4_version' is 1.17. Write one of"),
    ("surprise", 2, "unknown key 'surprise'"),
    ("vehicles.mav1.mass_kg", "heavy", "vehicles.mav1.mass_kg"),
    ("vehicles.mav1.mass_kg", -1.0, "between"),
    ("fleet.battery_land_pct", 120.0, "'fleet.battery_land_pct' is 120.0"),
    ("vehicles.mav1.mass_kg", float("nan"), "between"),
    ("vehicles.mav1.system_id", 1, "vehicles.mav0.system_id"),
    ("vehicles.mav1.system_id", 256, "between 1 and 255"),
    ("vehicles.mav1.agent", "tcp/127.0.0.1:7460", "vehicles.mav0.agent"),
    ("vehicles.mav1.autopilot", "udpin://127.0.0.1:14540", "vehicles.mav0.autopilot"),
    ("vehicles.mav1.autopilot", "14540", "udpin://127.0.0.1:14540"),
    ("vehicles.mav1.autopilot", "/dev/ttyACM0", "or as serial:///dev/ttyACM0:921600."),
    ("vehicles.-1", {}, "and does not begin with -. Rename the vehicle."),
    ("vehicles.mav1.type", "glider", "[types.glider]"),
    ("vehicles.mav1.start_enu_m", [-1.4, -1.5, 0.0], "0.10 m apart"),
    ("vehicles.mav1.start_enu_m", [9.0, 0.0, 0.0], "outside fleet.geofence_m"),
    ("vehicles.mav1.start_enu_m", [0.5, 0.0, -0.2], "0.2 m below the floor of fleet.geofence_m"),
    ("vehicles.mav1.start_enu_m", [9.0, 0.0], "start_enu_m"),
    ("formations.triangle.mav1", [-0.1, 0.7, 0.0], "can park"),
    ("formations.triangle.mav9", [5.0, 0.0, 0.0], "names no vehicle"),
    ("fleet.geofence_m", {"x": [1, -1], "y": [-1, 1], "z": [0, 1]}, "low < high"),
    (
        "fleet.geofence_m",
        {"x": [-1e308, 1e308], "y": [-9, 9], "z": [-1, 9]},
        "'fleet.geofence_m.x' is -1e+308; it must lie between -10000 and 10000",
    ),
    ("fleet.name", "a/b", "fleet.name"),
    ("fleet.body_diameter_m", 2.0, "fleet.body_diameter_m"),
    ("fleet.safety_distance_m", 0.4, "One bound is 'fleet.safety_distance_m'"),
    ("fleet.battery_land_pct", 40.0, "One bound is 'fleet.battery_land_pct'"),
    ("types.ardrone.px4_version", "1.15", 'Write one of "1.16", "1.17", "1.18", in quotes'),
    ("vehicles.mav1.px4_version", 1.17, "'vehicles.mav1.px4_version' is 1.17. Write one of"),
    ("fleet.keys", "keys; touch X #", "fleet.keys"),
    ("fleet.keys", "$(touch X)", "has other characters than A-Z a-z 0-9 _ . / -"),
    ("fleet.keys", "keys\n", "has other characters"),
    ("fleet.keys", "", "has other characters"),
    ("fleet.keys", "../../../etc", "leaves the folder of the fleet file with '..'. Name a folder"),
    ("fleet.keys", "keys/../../etc", "leaves the folder"),
    ("fleet.keys", "/etc", "is no path relative to the fleet file"),
    ("fleet.keys", "-keys", 'for instance keys = "keys"'),
    ("law.folder", "laws; touch X #", "law.folder"),
    ("law.passing_heights", 2, "'fleet.vertical_separation_m' is not given"),
    ("law.passing_heights", 3, "law.passing_heights"),
    ("law.folder", "../laws", "leaves the folder of the fleet file"),
    ("law.folder", "/no/such/folder", "is not on this computer. Name a folder beside"),
    ("law.folder", "/no/such/folder", 'for instance folder = "laws"'),
    ("vehicles.mav1.agent", "tcp/127.0.0.1:99999", "a port is a number from 1 to 65535"),
    ("vehicles.mav1.agent", "tcp/127.0.0.1:0", "'vehicles.mav1.agent' is 'tcp/127.0.0.1:0'"),
    ("vehicles.mav1.autopilot", "udpin://127.0.0.1:65536", "a port is a number from 1 to 65535"),
    ("vehicles.mav1.direct", "udpout://127.0.0.1:99999", "a port is a number from 1 to 65535"),
    ("vehicles.mav1.agent", "tcp/...:7461", "'tcp/...:7461', which does not end in a host"),
    ("vehicles.mav1.agent", "tcp/::::7461", "does not end in a host"),
    ("vehicles.mav1.agent", "tcp/10.0.0.256:7461", "does not end in a host"),
    ("vehicles.mav1.agent", "tcp/[10.0.0.5]:7461", "does not end in a host"),
    ("vehicles.mav1.autopilot", "udpin://127.0.0.1", "'vehicles.mav1.autopilot' is 'udpin://127"),
    ("vehicles.mav1.autopilot", "udpin://foo", "does not end in a host"),
    ("vehicles.mav1.autopilot", "udpin://a b:14541", "does not end in a host"),
    ("vehicles.mav1.autopilot", "udpin://foo:port", "does not end in a host"),
    ("vehicles.mav1.autopilot", "serial:///dev/ttyAMA0", "has no device and baud rate. Write it"),
    ("vehicles.mav1.autopilot", "serial:///dev/ttyAMA0:0", "has no device and baud rate"),
    ("vehicles.mav1.autopilot", "serial:///dev/ttyAMA0:RKINT", "has no device and baud rate"),
    ("vehicles.mav1.autopilot", "serial://:921600", "has no device and baud rate"),
    ("vehicles.mav1.direct", "udpout://..:18570", "'vehicles.mav1.direct' is 'udpout://..:18570'"),
    ("fleet.simulator", "tcp/-.:7459", "'fleet.simulator' is 'tcp/-.:7459', which does not end"),
    ("fleet.routers", ["tcp/[::g]:7447"], "'fleet.routers[0]' is 'tcp/[::g]:7447', which"),
    ("vehicles.mav1.direct", "udpout://[fd00::2]:18570", "cannot open links to IPv6 addresses"),
    ("vehicles.mav1.direct", "udpin://[::1]:18570", "cannot open links to IPv6 addresses"),
    ("vehicles.mav1.direct", "tcp://[fd00::2]:5760", "Write PX4's IPv4 address or its name"),
    ("vehicles.mav1.direct", "127.0.0.1:18570", "write it as udpout://127.0.0.1:18570"),
    ("vehicles.mav1.px4_params", {"com_of_loss_t": 5.0}, "'com_of_loss_t'; a parameter of PX4"),
    ("vehicles.mav1.px4_params", {"A_NAME_OF_17_CHARS": 1}, "up to 16 of the characters"),
    ("vehicles.mav1.px4_params", {"MPC_Z_P\x1b": 1}, "up to 16 of the characters"),
    ("vehicles.mav1.px4_params", {"MC_ROLL_P": 1e308}, "'vehicles.mav1.px4_params.MC_ROLL_P' is"),
    ("vehicles.mav1.px4_params", {"MC_ROLL_P": -3.41e38}, "between -3.40282e+38 and 3.40282e+38"),
    ("types.ardrone.px4_params", {"NAV_DLL_ACT": 2**31}, "'types.ardrone.px4_params.NAV_DLL_ACT'"),
    ("vehicles.mav1.px4_params", {"NAV_DLL_ACT": -(2**31) - 1}, "is -2147483649; it must lie"),
    ("fleet.simulator", "tcp/127.0.0.1:65536", "'fleet.simulator' is 'tcp/127.0.0.1:65536'"),
    ("fleet.routers", ["tcp/10.0.0.1:70000"], "'fleet.routers[0]' is 'tcp/10.0.0.1:70000'"),
    ("schema", 2, "reads schema = 1. The file is for a newer Covey: read it with that one."),
    ("schema", 0, "reads schema = 1. Put 'schema = 1' on the first line."),
    ("schema", True, "schema is True, this version reads schema = 1. Put 'schema = 1' on"),
]


def test_a_wrong_value_is_refused_with_file_key_and_bound() -> None:
    for key, value, words in WRONG:
        data = paper_data()
        set_path(data, key, value)
        with pytest.raises(ConfigError) as error:
            fleet_from_mapping(data, path="my.toml")
        assert str(error.value).startswith("my.toml: "), f"{key} = {value}"
        assert words in str(error.value), f"{key} = {value}"


def test_folders_below_the_fleet_file_are_taken_and_those_of_covey_s_own_copies(
    tmp_path: Path,
) -> None:
    for keys, folder in (("keys", "."), ("safe/keys_2-a", "laws/mine"), ("./keys..old", "./laws")):
        data = paper_data()
        data["fleet"]["keys"] = keys
        data.setdefault("law", {})["folder"] = folder
        assert fleet_from_mapping(data).fleet.keys == keys

    elsewhere = tmp_path / "a lab's keys"
    elsewhere.mkdir()
    data = paper_data()
    data["fleet"]["keys"] = str(elsewhere)
    data["law"]["folder"] = str(elsewhere)
    with pytest.raises(ConfigError, match=r"fleet\.keys"):  # it holds no keys
        fleet_from_mapping(data)
    (elsewhere / "ca.pem").write_text("certificate")
    assert fleet_from_mapping(data).keys_folder == str(elsewhere)


def test_spots_and_slots_at_exactly_the_least_distance_are_taken() -> None:
    data = paper_data()
    data["fleet"]["safety_distance_m"] = 0.8
    parking_m = parking_distance_m(fleet_from_mapping(data))
    data["vehicles"]["mav0"]["start_enu_m"] = [1.6, -1.5, 0.0]
    data["vehicles"]["mav1"]["start_enu_m"] = [2.4, -1.5, 0.0]  # 2.4 - 1.6 < 0.8, by rounding
    data["vehicles"]["mav2"]["start_enu_m"] = [0.8, -1.5, 0.0]
    data["formations"]["triangle"] = {
        "mav0": [0.0, 0.0, 0.0],
        "mav1": [parking_m * (1.0 - 1e-12), 0.0, 0.0],
    }
    assert len(fleet_from_mapping(data).vehicles) == 3


def test_px4_params_may_have_all_values_of_32_bits() -> None:
    data = paper_data()
    values = {"MC_ROLL_P": 3.4028234663852886e38, "NAV_DLL_ACT": -(2**31), "SYS_HAS_GPS": 2**31 - 1}
    data["vehicles"]["mav1"]["px4_params"] = values
    assert fleet_from_mapping(data).vehicles["mav1"].px4_params == values


def test_the_keys_lie_beside_the_fleet_file_and_not_beside_a_link_to_it(tmp_path: Path) -> None:
    real = tmp_path / "real"
    link = tmp_path / "link"
    real.mkdir()
    link.mkdir()
    (real / "fleet.toml").write_text(PAPER.read_text())
    (link / "fleet.toml").symlink_to(real / "fleet.toml")
    assert Path(load_fleet(link / "fleet.toml").keys_folder) == real.resolve() / "keys"


def test_an_autopilot_s_endpoint_is_of_its_companion() -> None:
    data = paper_data()
    for index, vehicle in enumerate(data["vehicles"].values()):
        vehicle |= {
            "agent": f"tcp/192.168.1.{11 + index}:7460",
            "autopilot": "serial:///dev/ttyAMA0:921600",
        }
    assert len(fleet_from_mapping(data).vehicles) == 3
    data["vehicles"]["mav1"]["agent"] = "tcp/192.168.1.11:7461"
    with pytest.raises(
        ConfigError, match=r"vehicles\.mav1\.autopilot.*on the same computer, 192\.168\.1\.11"
    ):
        fleet_from_mapping(data)


@pytest.mark.parametrize("drag_1_s", [0.0, 1e-6])
def test_a_drag_that_is_unknown_or_small_is_judged(drag_1_s: float) -> None:
    data = paper_data()
    data["fleet"]["max_wind_m_s"] = 5.0
    data["vehicles"]["mav1"]["drag_1_s"] = drag_1_s
    findings = fleet_findings(fleet_from_mapping(data))
    assert all(math.isfinite(one.value) for one in findings)


@pytest.mark.parametrize(
    ("key", "endpoint", "other"),
    [
        ("autopilot", "udpin://0.0.0.0:14540", "vehicles.mav0.autopilot"),
        ("autopilot", "udpin://localhost:14540", "vehicles.mav0.autopilot"),
        ("autopilot", "udpin://[::]:14540", "vehicles.mav0.autopilot"),
        ("direct", "udpin://127.0.0.1:14540", "vehicles.mav0.autopilot"),
        ("direct", "udpin://127.0.0.1:14541", "vehicles.mav1.autopilot"),
        ("direct", "udpout://LOCALHOST:18570", "vehicles.mav0.direct"),
        ("autopilot", "udpout://127.0.0.1:18570", "vehicles.mav0.direct"),
        ("agent", "tcp/localhost:7460", "vehicles.mav0.agent"),
        ("agent", "tcp/localhost:07459", "fleet.simulator"),
    ],
)
def test_one_port_has_one_key_however_it_is_written(key: str, endpoint: str, other: str) -> None:
    data = paper_data()
    data["fleet"]["simulator"] = "tcp/127.0.0.1:7459"
    data["vehicles"]["mav1"][key] = endpoint
    with pytest.raises(ConfigError) as error:
        fleet_from_mapping(data)
    assert f"'vehicles.mav1.{key}'" in str(error.value)
    assert f"'{other}'" in str(error.value)


def test_one_serial_device_has_one_agent_at_any_baud_rate() -> None:
    data = paper_data()
    data["vehicles"]["mav0"]["autopilot"] = "serial:///dev/ttyAMA0:921600"
    data["vehicles"]["mav1"]["autopilot"] = "serial:///dev/ttyAMA0:57600"
    with pytest.raises(ConfigError, match="the same port or device, on the same computer"):
        fleet_from_mapping(data)


@pytest.mark.parametrize("host", ["0.0.0.0", "127.0.0.1", "192.168.7.1"])
def test_each_companion_may_listen_for_its_px4_at_the_same_port(host: str) -> None:
    data = paper_data()
    for index, vehicle in enumerate(data["vehicles"].values()):
        vehicle["agent"] = f"tcp/192.168.1.{11 + index}:7460"
        vehicle["autopilot"] = f"udpin://{host}:14540"
        vehicle["direct"] = f"udpout://192.168.1.{11 + index}:14550"
    assert len(fleet_from_mapping(data).vehicles) == 3


def test_agents_of_one_computer_may_listen_at_one_port_of_different_networks() -> None:
    data = paper_data()
    for index, vehicle in enumerate(data["vehicles"].values()):
        vehicle["autopilot"] = f"udpin://192.168.{index}.1:14540"
    assert len(fleet_from_mapping(data).vehicles) == 3


def test_the_ground_may_send_to_the_same_port_of_px4_as_its_agent() -> None:
    data = paper_data()
    data["vehicles"]["mav0"]["autopilot"] = "udpout://192.168.1.21:14540"
    data["vehicles"]["mav0"]["direct"] = "udpout://192.168.1.21:14540"
    assert len(fleet_from_mapping(data).vehicles) == 3


@pytest.mark.parametrize(
    "host", ["mav1", "mav1.local", "drone_2-b.lab.example", "4u.local", "192.168.1.12", "[fd00::2]"]
)
def test_names_and_addresses_of_both_kinds_are_hosts(host: str) -> None:
    data = paper_data()
    data["vehicles"]["mav1"] |= {
        "agent": f"tcp/{host}:7461",
        "autopilot": f"udpout://{host}:14541",
    }
    if not host.startswith("["):  # the ground opens no IPv6 addresses
        data["vehicles"]["mav1"]["direct"] = f"tcp://{host}:5760"
    assert fleet_from_mapping(data).vehicles["mav1"].host == host


@pytest.mark.parametrize("name", ["ground", "ground-east", "watcher-2", "recorder-a", "sitl-1"])
def test_a_vehicle_whose_name_is_that_of_another_kind_of_node_is_refused(name: str) -> None:
    data = paper_data()
    data["vehicles"][name] = data["vehicles"].pop("mav2")
    with pytest.raises(ConfigError, match=f"A vehicle is named '{name}'"):
        fleet_from_mapping(data)


@pytest.mark.parametrize("name", ["viewer", "mocap", "corrections", "router", "ca"])
def test_a_vehicle_whose_name_is_that_of_another_nodes_key_is_refused_before_there_are_keys(
    name: str,
) -> None:
    data = paper_data()
    data["vehicles"][name] = data["vehicles"].pop("mav2")
    with pytest.raises(ConfigError, match=f"'{name}', which is the name of another node's key"):
        fleet_from_mapping(data)


@pytest.mark.parametrize("name", ["all", "ALL", "Yaw", "0-1"])
def test_a_vehicle_whose_name_has_another_meaning_in_orders_is_refused(name: str) -> None:
    data = paper_data()
    data["vehicles"][name] = data["vehicles"].pop("mav2")
    with pytest.raises(ConfigError, match=f"'{name}', which means something else in an order"):
        fleet_from_mapping(data)


def test_a_missing_key_of_a_vehicle_is_named() -> None:
    for key in ("system_id", "start_enu_m", "agent", "autopilot"):
        data = paper_data()
        del data["vehicles"]["mav2"][key]
        with pytest.raises(ConfigError, match=rf"vehicles\.mav2\.{key}"):
            fleet_from_mapping(data)


def test_a_missing_file_and_broken_toml_are_sentences(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="no such fleet file"):
        load_fleet(tmp_path / "none.toml")
    (tmp_path / "broken.toml").write_text("schema = = 1")
    with pytest.raises(ConfigError, match="not valid TOML"):
        load_fleet(tmp_path / "broken.toml")
    (tmp_path / "broken.toml").write_text("[fences]\nname = 'a'\n[fences]\nname = 'b'\n")
    with pytest.raises(ConfigError, match=r"each begins with two brackets: \[\[fences\]\]\."):
        load_fleet(tmp_path / "broken.toml")
    with pytest.raises(ConfigError, match="cannot be read"):
        load_fleet(tmp_path)


def test_a_vehicle_overrides_its_type_which_overrides_the_defaults() -> None:
    data = paper_data()
    data["defaults"]["max_speed_m_s"] = 0.5
    data["defaults"]["max_acceleration_m_s2"] = 0.7
    data["vehicles"]["mav1"]["mass_kg"] = 0.6
    data["vehicles"]["mav1"]["sitl"] = {"static_gain": 0.8}
    config = fleet_from_mapping(data)
    assert config.vehicles["mav1"].mass_kg == 0.6
    assert config.vehicles["mav0"].mass_kg == 0.510
    assert config.vehicles["mav0"].max_speed_m_s == 1.0  # the type says so
    assert config.vehicles["mav0"].max_acceleration_m_s2 == 0.7  # only the defaults say so
    assert config.vehicles["mav1"].sitl.static_gain == 0.8
    assert config.vehicles["mav1"].sitl.tilt_bias_deg == 1.5


def test_the_hash_changes_with_any_value_and_not_with_comments() -> None:
    first = fleet_from_mapping(paper_data(), text="a")
    same = fleet_from_mapping(paper_data(), text="b")
    data = paper_data()
    data["law"]["design_margin_m"] = 0.2
    assert first.config_hash == same.config_hash
    assert first.config_hash != fleet_from_mapping(data).config_hash


@pytest.fixture
def paper() -> FleetConfig:
    return load_fleet(PAPER)


def test_a_number_that_is_none_is_refused_with_its_place() -> None:
    values = tomllib.loads("a = 1\n[[step]]\n[[step]]\nheights_m = [1.0, nan]")
    with pytest.raises(ConfigError, match=r"my.toml: nan stands .* at 'step\[1\]\.heights_m\[1\]'"):
        check_values(values, "my.toml")


@pytest.mark.parametrize(
    ("table", "key"),
    [
        ('[fleet]\nname = "paper"\nkeys = "\\u0000"', "fleet.keys"),
        ('[formations.ring]\nshape = "csv"\nfile = "a\\u0000"', "formations.ring.file"),
    ],
)
def test_a_text_with_a_character_that_no_path_has_is_refused_with_its_place(
    tmp_path: Path, table: str, key: str
) -> None:
    file = tmp_path / "my.toml"
    file.write_text(f"schema = 1\n{table}\n")
    with pytest.raises(ConfigError, match=rf"my.toml: a text has .* U\+0000 at '{key}'"):
        load_fleet(file)


@pytest.mark.parametrize("key", ["step", "fleet"])
def test_a_mission_file_is_told_from_a_fleet_file(key: str) -> None:
    values = {"step": [{"do": "land"}], "fleet": "paper"}
    with pytest.raises(ConfigError, match="is a mission file, not a fleet file"):
        fleet_from_mapping({"schema": 1, key: values[key]}, path="my.toml")


def test_vehicles_are_selected_by_name_index_and_range(paper: FleetConfig) -> None:
    assert paper.select("all") == paper.select(None) == ("mav0", "mav1", "mav2")
    assert paper.select("mav2,0") == ("mav2", "mav0")
    assert paper.select("1-2") == ("mav1", "mav2")
    assert paper.select("all", "mav1") == ("mav0", "mav2")
    for empty in ([], "", " ", [""], iter(())):
        with pytest.raises(ConfigError, match="the list of vehicles is empty"):
            paper.select(empty)
    for wrong in ("2-1", "7", "mav9", "1-9", ",", ["mav0", ""]):
        with pytest.raises(ConfigError):
            paper.select(wrong)


def fleet_named(*names: str) -> FleetConfig:
    """The paper's fleet with other names of its three vehicles."""
    data = paper_data()
    del data["formations"]
    data["vehicles"] = dict(zip(names, data["vehicles"].values(), strict=True))
    return fleet_from_mapping(data)


@pytest.mark.parametrize(
    ("names", "text", "selected"),
    [
        (("1", "2", "3"), "1-2", ("1", "2")),
        (("1", "2", "3"), "3,1-2", ("3", "1", "2")),
        (("3", "2", "1"), "1-2", ("1", "2")),
        (("01", "02", "03"), "1-2", ("01", "02")),
        (("01", "02", "03"), "02-03", ("02", "03")),
        (("01", "02", "03"), "1", ("01",)),
        (("10", "11", "12"), "0-1", ("10", "11")),
    ],
)
def test_a_span_of_numbers_that_are_names_selects_these_names(
    names: tuple[str, ...], text: str, selected: tuple[str, ...]
) -> None:
    assert fleet_named(*names).select(text) == selected


@pytest.mark.parametrize(
    ("names", "text", "named"),
    [
        (("1", "2", "3"), "0-2", "1, 2"),
        (("1", "2", "3"), "2-4", "2, 3"),
        (("1", "2", "4"), "1-4", "1, 2, 4"),
        (("mav0", "mav1", "2"), "1-2", "2"),
        (("1", "01", "2"), "1-2", "1, 01, 2"),
    ],
)
def test_a_span_is_refused_if_only_some_of_its_numbers_are_names(
    names: tuple[str, ...], text: str, named: str
) -> None:
    fleet = fleet_named(*names)
    with pytest.raises(ConfigError, match=f"'{text}' is not clear: .* are {named}. Name each"):
        fleet.select(text)


@pytest.mark.parametrize(
    ("names", "labels"),
    [
        (("mav0", "mav1", "mav2"), ("0", "1", "2")),
        (("2", "1", "0"), ("2", "1", "0")),
        (("1", "2", "3"), ("1", "2", "3")),
        (("mav0", "0", "mav2"), ("mav0", "0", "mav2")),
    ],
)
def test_a_label_means_its_vehicle_in_an_order(
    names: tuple[str, ...], labels: tuple[str, ...]
) -> None:
    fleet = fleet_named(*names)
    assert tuple(fleet.labels.values()) == labels
    for name, label in fleet.labels.items():
        assert fleet.select(label) == (name,)


def test_the_paper_law_parks_no_closer_than_its_own_formula(paper: FleetConfig) -> None:
    data = paper_data()
    data["law"] = {"name": "paper", "paper_v_perp_m_s": 0.3, "paper_kappa_3_1_s": 1.0}
    assert parking_distance_m(fleet_from_mapping(data)) == pytest.approx((0.64 + 0.8 * 0.3) ** 0.5)
    assert parking_distance_m(paper) > paper.fleet.safety_distance_m


def test_the_papers_ring_is_refused_for_more_than_three_unless_forced() -> None:
    data = paper_data()
    data["vehicles"]["mav3"] = {
        "system_id": 4,
        "start_enu_m": [3.0, -1.5, 0.0],
        "agent": "tcp/127.0.0.1:7463",
        "autopilot": "udpin://127.0.0.1:14543",
    }
    assert fleet_from_mapping(data)
    data["law"] = {"name": "paper"}
    with pytest.raises(ConfigError, match=r"law\.paper_force_ring"):
        fleet_from_mapping(data)
    data["law"]["paper_force_ring"] = True
    assert fleet_from_mapping(data)
