"""Keys of MAVLink signing from the file to the emulated PX4, and what speaks to it with them."""

from __future__ import annotations

import re
import stat
from pathlib import Path

import pytest

from groundstation.cli import main
from groundstation.client.direct_mavlink import send_direct
from onboard.config.fleet import ConfigError, FleetConfig, load_fleet
from onboard.px4.mavsdk_link import Px4Link
from onboard.security.mavlink_key import mavlink_key
from sitl.px4.signing import KEY_BYTES
from tests.groundstation.px4.test_px4 import FLEET, emulator, fleet, free_port  # noqa: F401

NEW = FLEET.replace("hover_thrust_frac = 0.49", 'hover_thrust_frac = 0.49\npx4_version = "1.18"')


@pytest.fixture(autouse=True)
def newest(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("tests.groundstation.px4.test_px4.FLEET", NEW)
    monkeypatch.delenv("MAVLINK20", raising=False)  # other tests set it for pymavlink


def test_a_key_is_made_and_set_and_all_that_speaks_to_px4_uses_it(
    fleet: FleetConfig,  # noqa: F811
    emulator: object,  # noqa: F811
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    path = fleet.path
    signing = ["px4", "signing", "--fleet", fleet.path]
    assert main([*signing, "--set"]) == 2  # no key yet
    assert main(["secure", path, "--mavlink"]) == 0
    assert main(["secure", path, "--mavlink"]) == 0
    signed = load_fleet(path)
    assert signed.vehicles["solo"].mavlink_signing
    file = Path(signed.keys_folder) / "solo.mavlink.key"
    assert (len(file.read_bytes()), stat.S_IMODE(file.stat().st_mode)) == (KEY_BYTES, 0o600)
    assert main([*signing, "--set"]) == 0
    assert (
        "the key is set: PX4 signs with it and ignores what is not signed."
        in capsys.readouterr().out
    )
    assert main(["px4", "params", "--fleet", path]) == 1  # heard, and wrong
    vehicle = signed.vehicles["solo"]
    key = mavlink_key(signed, "solo")
    assert vehicle.direct is not None
    monkeypatch.delenv("MAVLINK20")  # as in a process that has not heard PX4 before
    assert send_direct(
        vehicle.direct, vehicle.system_id, "kill", key=key, timeout_s=5.0
    ).is_accepted
    assert not send_direct(vehicle.direct, vehicle.system_id, "kill", timeout_s=0.5).is_accepted
    agents = Px4Link(vehicle.autopilot, vehicle.system_id, key=key)
    agents.start()
    try:
        assert any(agents.connect(1.0) for _ in range(10))
        assert agents.read_params({"COM_OF_LOSS_T": 0.3}) == {"COM_OF_LOSS_T": 1.0}
        assert agents.snapshot().is_signed
    finally:
        agents.stop()


@pytest.mark.long
def test_a_key_is_looked_at_changed_and_removed(
    fleet: FleetConfig,  # noqa: F811
    emulator: object,  # noqa: F811
    capsys: pytest.CaptureFixture[str],
) -> None:
    path = fleet.path
    signing = ["px4", "signing", "--fleet", fleet.path]

    def says(status: int, words: str, *options: str) -> None:
        assert main([*signing, *options]) == status
        said = capsys.readouterr().out
        assert words in said, said

    says(0, "solo: PX4 v1.18 does not sign its messages.")
    assert main(["secure", path, "--mavlink"]) == 0
    says(1, "The fleet file says mavlink_signing = true.")
    says(0, "the key is set", "--set")
    says(
        0,
        "nothing was changed: PX4 v1.18 signs its messages with the key of this vehicle already",
        "--set",
    )
    assert main(["px4", "info", "--fleet", path]) == 0
    said = capsys.readouterr().out
    assert "it signs with the key of this vehicle" in said
    assert f"{load_fleet(path).vehicles['solo'].direct}: answers" in said
    (Path(fleet.keys_folder) / "solo.mavlink.key").rename("old.key")
    assert main(["secure", path, "--mavlink"]) == 0
    says(1, "with another key than this computer's")
    says(1, "Give the key that it has with --set --old FILE", "--set")
    says(0, "the key is set", "--set", "--old", "old.key")
    says(0, "Write mavlink_signing = false", "--remove")


def test_a_key_that_is_missing_readable_or_none_and_a_version_that_cannot_sign_are_refused_in_words(
    fleet: FleetConfig,  # noqa: F811
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert main(["secure", fleet.path, "--mavlink"]) == 0
    signed = load_fleet(fleet.path)
    file = Path(signed.keys_folder) / "solo.mavlink.key"
    key = file.read_bytes()

    def cut() -> None:
        file.chmod(0o600)
        file.write_bytes(key[:31])

    for change, words in (
        (lambda: file.chmod(0o644), "can be read by other users.* chmod 600"),
        (cut, "holds no key"),
        (lambda: file.write_bytes(bytes(KEY_BYTES)), "holds no key"),
        (file.unlink, "cannot be read.*covey keys secure .* --mavlink"),
    ):
        change()
        with pytest.raises(ConfigError, match=words):
            mavlink_key(signed, "solo")
    assert main(["agent", "--fleet", fleet.path, "--vehicle", "solo"]) == 2
    assert "solo.mavlink.key cannot be read" in capsys.readouterr().err
    text = Path(fleet.path).read_text().replace('px4_version = "1.18"', 'px4_version = "1.17"')
    Path(fleet.path).write_text(text)
    with pytest.raises(
        ConfigError, match=re.escape("PX4 v1.17 ('px4_version') can neither sign nor check")
    ):
        load_fleet(fleet.path)
