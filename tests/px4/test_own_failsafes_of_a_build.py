"""A real PX4 has the failsafe parameters that its version is said to have, and no others."""

from __future__ import annotations

import time
import tomllib
from pathlib import Path

import pytest

from groundstation.client.autopilot_link import AutopilotLink
from onboard.px4.own_failsafes import OWN_FAILSAFES
from sitl.px4.parameters import DEFAULTS
from tests.px4.build import Px4Build, Px4s, free_instances

pytestmark = [pytest.mark.long, pytest.mark.timeout(120)]

_LISTS = tomllib.loads(
    (Path(__file__).parents[1] / "onboard/px4/failsafe_parameters.toml").read_text(encoding="utf-8")
)
_FAMILIES = ("CBRK_", "COM_", "FD_", "GF_", "MAN_", "MOTFAIL_", "NAV_DLL", "NAV_RCL", "NAV_TRAFF")
_MODES = ("COM_FLTMODE", "COM_MODE")  # numbers of modes, which name no failsafe
_BOOT_S = 6.0


def test_no_failsafe_parameter_of_this_build_is_unknown(build: Px4Build, tmp_path: Path) -> None:
    if build.version is None:
        pytest.skip(f"{build.name} names no version")
    version = f"{build.version[0]}.{build.version[1]}"
    if version not in _LISTS:
        pytest.skip(f"nobody has read the source of v{version}")

    (number,) = free_instances(1)
    with Px4s(build, tmp_path) as px4s:
        px4s.start(number, {})
        time.sleep(_BOOT_S)
        link = AutopilotLink(f"udpin://127.0.0.1:{14540 + number}", number + 1, is_own=True)
        try:
            values = link.read_all()
        finally:
            link.stop()

    named = {name for name in values if name.startswith(_FAMILIES) and not name.startswith(_MODES)}
    assert named == set(_LISTS[version]["parameters"])

    # and the emulated PX4 of this version comes with the same values
    for failsafe in OWN_FAILSAFES:
        for own in failsafe.parameters:
            if own.name in values:
                assert values[own.name] == pytest.approx(DEFAULTS[version][own.name]), own.name
