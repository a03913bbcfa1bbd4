"""Python missions that call verbs, or vehicles, which the fleet does not have."""

import pytest

from groundstation.mission_files.loading import load_mission
from groundstation.missions.python_check import check_python
from onboard.config.fleet import ConfigError


def mission_of(tmp_path, body, head="async def mission(fleet):"):
    path = tmp_path / "show.py"
    lines = "\n".join(f"    {line}" for line in body)
    path.write_text(f"FLEET = 'paper.toml'\n\n\n{head}\n{lines}\n", encoding="utf-8")
    return load_mission(str(path), None)


def test_a_verb_that_does_not_exist_is_told_with_its_line_and_the_one_that_was_meant(tmp_path):
    mission = mission_of(tmp_path, ["await fleet.arm()", "await fleet.takof(height_m=1.0)"])
    with pytest.raises(ConfigError) as refusal:
        check_python(mission)
    words = "show.py: line 6: fleet.takof does not exist. Did you mean 'takeoff'?"
    assert words in str(refusal.value)


def test_the_fleet_may_have_another_name(tmp_path):
    mission = mission_of(tmp_path, ["await drones.dance()"], "async def mission(drones):")
    with pytest.raises(ConfigError, match=r"drones\.dance does not exist"):
        check_python(mission)


@pytest.mark.parametrize(
    "verb",
    ["fleet['mav0'].go_too", "fleet['mav0'].land_all", "fleet.group(['mav0']).dance"],
)
def test_a_vehicle_and_a_group_are_checked_as_well(tmp_path, verb):
    mission = mission_of(tmp_path, [f"await {verb}()"])
    with pytest.raises(ConfigError) as refusal:
        check_python(mission)
    assert f"show.py: line 5: {verb} does not exist." in str(refusal.value)


def test_a_vehicle_that_the_fleet_does_not_have_is_told_with_its_line(tmp_path):
    mission = mission_of(tmp_path, ["await fleet.arm()", "await fleet['mav9'].land()"])
    with pytest.raises(ConfigError) as refusal:
        check_python(mission)
    words = (
        "show.py: line 6: fleet['mav9'] does not exist. Vehicles of this fleet: mav0, mav1, mav2."
    )
    assert words in str(refusal.value)


@pytest.mark.parametrize(
    ("call", "words"),
    [
        ("fleet.takeoff(height=1.0)", "takes no argument 'height'. Did you mean 'height_m'?"),
        ("fleet['mav0'].go_to((0, 0, 1), yaw=90)", "takes no argument 'yaw'."),
        ("fleet.group(['mav0']).move()", "missing a required argument: "),
        ("fleet.land('all', 1, 2, 3, 4, 5, 6)", "too many positional arguments. It takes: "),
    ],
)
def test_an_argument_that_a_verb_does_not_take_is_told_with_its_line(tmp_path, call, words):
    with pytest.raises(ConfigError) as refusal:
        check_python(mission_of(tmp_path, ["await fleet.arm()", f"await {call}"]))
    verb, _, _ = call.rpartition("(")
    assert str(refusal.value).partition("show.py: ")[2].startswith(f"line 6: {verb[:11]}")
    assert words in str(refusal.value)


@pytest.mark.parametrize("reaction", ["fleet.hold", "fleet['mav0'].home", "go_home"])
def test_a_reaction_that_is_called_where_it_is_given_is_told_with_its_line(tmp_path, reaction):
    body = ["async def go_home():", "    pass", "async with fleet.reacting(any_of(), REACTION):"]
    called = [line.replace("REACTION", f"{reaction}()") for line in [*body, "    pass"]]
    with pytest.raises(ConfigError) as refusal:
        check_python(mission_of(tmp_path, called))
    assert f"show.py: line 7: {reaction}() is called at once" in str(refusal.value)
    assert str(refusal.value).endswith(f"Write the function without parentheses: {reaction}")


@pytest.mark.parametrize(
    "body",
    [
        ["await fleet.takeoff(**{'height_m': 1.0})", "await fleet.land(*['all'])"],
        ["await fleet.arm()", "await fleet['mav0'].reached(1.0)", "await fleet.land_all()"],
        ["await fleet.group(['mav0', 'mav1']).land()", "print(fleet['mav0'].yaw_deg.real)"],
        ["for name in fleet.names:", "    await fleet[name].land()"],
        ["fleet.dance = print", "fleet.dance()"],
        ["fleet = fleet.group(['mav0'])", "fleet.dance()"],
        ["for fleet in [print]:", "    fleet.dance()"],
        ["dance = lambda fleet: fleet.dance()", "dance(print)"],
        ["async with fleet.reacting(any_of(), fleet.hold):", "    pass"],
        ["async with fleet.reacting(any_of(), partial(fleet.hold, 'mav0')):", "    pass"],
    ],
)
def test_what_exists_and_what_is_not_surely_the_fleet_is_not_refused(tmp_path, body):
    check_python(mission_of(tmp_path, body))
