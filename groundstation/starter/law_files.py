"""The first files of a user's own law: its module, its test, and its line in the fleet file."""

from __future__ import annotations

import keyword
from importlib.resources import files

from onboard.config.fleet import ConfigError

_TEST = '''\
"""Whether the law of fleet.toml brings two vehicles past each other."""

from __future__ import annotations

from pathlib import Path

from onboard.config.fleet import load_fleet
from sitl.monte_carlo import scenarios, campaign_settings
from sitl.monte_carlo.batch_flight import fly

FLEET = str(Path(__file__).with_name("fleet.toml"))


def test_two_vehicles_pass_each_other_and_the_law_was_never_refused() -> None:
    assert load_fleet(FLEET).own_law is not None
    (flown,) = fly([scenarios.plan("swap2", 0)], campaign_settings.setup_for(fleet_path=FLEET))
    assert flown.law_refusal == ""
    assert not flown.outcome.is_collision
'''


def law_module(name: str) -> str:
    """Return the name of the law's module.

    Raises:
        ConfigError: Python cannot import a module of this name.
    """
    is_module_name = name.isidentifier() and name.isascii() and not keyword.iskeyword(name)
    if not is_module_name:
        raise ConfigError(
            f"--law is {name!r}; it becomes a module, so write letters, digits and _, as in my_law."
        )
    return name


def own_law_texts() -> tuple[str, str]:
    """Return the law's module and its test."""
    template = files("groundstation.starter").joinpath("own_law_template.py")
    return template.read_text(encoding="utf-8"), _TEST


def with_own_law(fleet_text: str, name: str) -> str:
    """Return the text of a new fleet file with the user's law.

    Args:
        fleet_text: text of a fleet file with Covey's law.
        name: name of the law's module.
    """
    name_line = f'name = "{name}:law"  # the function law of {name}.py beside this file'
    return fleet_text.replace('[law]\nname = "covey"', f"[law]\n{name_line}", 1)
