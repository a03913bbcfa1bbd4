"""One agent for one autopilot, whatever the wire."""

from __future__ import annotations

import os
import socket
import stat
import tempfile
from pathlib import Path

import pytest

from onboard.autopilot import LinkError
from onboard.px4 import port_lock
from onboard.px4.mavsdk_link import Px4Link
from onboard.px4.port_lock import PortClaim

DEVICE = f"/dev/covey-test-{os.getpid()}"


SAME = {
    "addresses": ("udpin://127.0.0.1:28991", "udpin://0.0.0.0:28991"),
    "remote": ("udpout://10.9.9.9:14550", "udpout://10.9.9.9:14550"),
    "serial": (f"serial://{DEVICE}:921600", f"serial://{DEVICE}:57600"),
    "serial without a rate": (f"serial://{DEVICE}:921600", f"serial://{DEVICE}"),
}


def test_the_second_of_two_agents_is_refused_in_words_until_the_first_releases_the_port() -> None:
    for first, second in SAME.values():
        holder = PortClaim(first)
        newcomer = PortClaim(second)
        holder.take()
        holder.take()
        try:
            with pytest.raises(LinkError, match="is in use"):
                newcomer.take()
        finally:
            holder.release()
        newcomer.take()
        newcomer.release()
        newcomer.release()


@pytest.mark.parametrize(
    "endpoint",
    ["udpout://10.9.9.9:28994", f"serial://{DEVICE}:921600"],
    ids=["remote", "serial"],  # workers name the device differently
)
def test_an_agent_of_another_user_is_refused_too(
    endpoint: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    holder = PortClaim(endpoint)
    newcomer = PortClaim(endpoint)
    umask = os.umask(0o077)
    try:
        holder.take()
    finally:
        os.umask(umask)

    (lock_file,) = tmp_path.iterdir()
    assert stat.S_IMODE(lock_file.stat().st_mode) == 0o644
    monkeypatch.setattr(os, "getuid", lambda: 12345)
    opened = os.open

    def open_as_another_user(path: Path, flags: int, *more: int) -> int:
        if flags & (os.O_CREAT | os.O_WRONLY | os.O_RDWR) and path.exists():
            raise PermissionError(13, "Permission denied", str(path))
        return opened(path, flags, *more)

    monkeypatch.setattr(os, "open", open_as_another_user)
    with pytest.raises(LinkError, match="is in use"):
        newcomer.take()
    holder.release()
    newcomer.take()
    newcomer.release()


def test_without_a_usable_temporary_folder_an_endpoint_is_refused_in_words(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    claim = PortClaim(f"serial://{DEVICE}:921600")
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "missing"))
    with pytest.raises(LinkError, match=r"cannot be locked .* Give this user a temporary folder"):
        claim.take()

    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    claim.take()
    claim.release()
    (lock_file,) = tmp_path.iterdir()
    lock_file.unlink()
    lock_file.symlink_to(tmp_path / "elsewhere")  # a link of somebody else is not followed
    with pytest.raises(LinkError, match="cannot be locked"):
        claim.take()


@pytest.mark.parametrize(
    ("endpoint", "is_shared"),
    [
        ("udpin://127.0.0.1:28992", False),
        ("udpout://10.9.9.9:28992", False),
        pytest.param(f"serial://{DEVICE}:921600", True, id="serial"),  # workers name it differently
    ],
)
def test_a_port_is_locked_in_its_own_network_namespace_only(
    endpoint: str, is_shared: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    here = PortClaim(endpoint)
    there = PortClaim(endpoint)
    here.take()
    # an agent in a container that shares the temporary folder
    (tmp_path / "net").touch()
    monkeypatch.setattr(port_lock, "_NAMESPACE", str(tmp_path / "net"))
    monkeypatch.setattr(socket.socket, "bind", lambda *_: None)  # its own ports
    try:
        if is_shared:
            with pytest.raises(LinkError, match="is in use"):
                there.take()
        else:
            there.take()
    finally:
        here.release()
        there.release()


def test_different_autopilots_do_not_hinder_each_other() -> None:
    claims = [PortClaim(f"serial://{DEVICE}{number}:921600") for number in range(3)]
    claims += [PortClaim(f"udpout://10.9.9.9:{14550 + number}") for number in range(3)]
    for claim in claims:
        claim.take()
    for claim in claims:
        claim.release()


def test_a_port_of_an_ipv6_address_is_claimed_and_refused_while_another_program_has_it() -> None:
    with socket.socket(socket.AF_INET6, socket.SOCK_DGRAM) as other:
        try:
            other.bind(("::1", 0))
        except OSError:
            pytest.skip("this computer has no IPv6")
        claim = PortClaim(f"udpin://[::1]:{other.getsockname()[1]}")
        with pytest.raises(LinkError, match="is in use"):
            claim.take()
    claim.take()
    claim.release()


@pytest.mark.parametrize("host", ["203.0.113.1", "nobody.invalid"])
def test_an_address_of_another_computer_is_not_called_in_use(host: str) -> None:
    link = Px4Link(f"udpin://{host}:28993", 1)
    with pytest.raises(LinkError, match=r"cannot be opened .* correct 'autopilot'"):
        link.start()


def test_a_port_that_cannot_exist_is_refused_in_words() -> None:
    link = Px4Link("udpin://127.0.0.1:70000", 1)
    with pytest.raises(LinkError, match="70000 is no port"):
        link.start()
