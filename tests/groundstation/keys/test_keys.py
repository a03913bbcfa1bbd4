"""A fleet's keys: made, issued, replaced, and refused in words when they do not fit."""

from __future__ import annotations

import base64
import datetime
import resource
import shutil
import subprocess
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from groundstation.cli import main
from groundstation.keys.authority import issue, load_authority, nodes_of
from groundstation.keys.mavlink_keys import sign_mavlink
from groundstation.keys.secured_fleet import secure_fleet
from onboard.config.fleet import ConfigError, FleetConfig, fleet_from_mapping, load_fleet, read_toml
from onboard.security.credentials import credentials_of
from onboard.security.mavlink_key import mavlink_key

PAPER = Path(__file__).parents[3] / "configs" / "fleets" / "paper.toml"
NOW = datetime.datetime.now(datetime.UTC)


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a fleet that has keys."""
    folder = tmp_path_factory.mktemp("fleet")
    shutil.copy(PAPER, folder / "fleet.toml")
    secure_fleet(str(folder / "fleet.toml"), NOW)
    return folder


@pytest.fixture
def folder(made: Path, tmp_path: Path) -> Path:
    """A copy of it."""
    return Path(shutil.copytree(made, tmp_path / "copy"))


def test_every_node_gets_its_files_and_the_comments_of_the_fleet_file_stay(made: Path) -> None:
    fleet = load_fleet(made / "fleet.toml")
    assert [vehicle.agent.partition("/")[0] for vehicle in fleet.vehicles.values()] == ["quic"] * 3
    assert [line for line in fleet.text.splitlines() if "#" in line] == [
        line for line in PAPER.read_text(encoding="utf-8").splitlines() if "#" in line
    ]
    for node in nodes_of(fleet):
        assert credentials_of(fleet, node) is not None
    assert {oct(path.stat().st_mode & 0o777) for path in (made / "keys").glob("*.key")} == {"0o600"}
    assert credentials_of(load_fleet(PAPER), "mav0") is None


@pytest.mark.parametrize("has_corrections", [False, True])
def test_the_files_of_the_relay_of_corrections_are_named_if_the_fleet_has_one(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], has_corrections: bool
) -> None:
    text = PAPER.with_name("px4-sitl.toml").read_text(encoding="utf-8")
    if has_corrections:
        text += '\n[corrections]\nsource = "mock"\n'
    path = tmp_path / "fleet.toml"
    path.write_text(text, encoding="utf-8")
    assert main(["keys", "secure", str(path)]) == 0
    line = "to the computer of covey corrections: fleet.toml, keys/ca.pem, keys/corrections.pem"
    assert (line in capsys.readouterr().out) is has_corrections


def test_a_second_call_changes_nothing_and_makes_what_is_missing(folder: Path) -> None:
    before = {path.name: path.read_bytes() for path in (folder / "keys").iterdir()}
    (folder / "keys" / "mav1.key").unlink()
    assert main(["secure", str(folder / "fleet.toml")]) == 0
    after = {path.name: path.read_bytes() for path in (folder / "keys").iterdir()}
    assert {name for name in before if before[name] != after[name]} == {"mav1.key", "mav1.pem"}


@pytest.mark.parametrize(
    "lost", [["ca.pem"], ["ca.pem", "mav1.key"], ["ca.pem", "ca.key"]], ids="-".join
)
def test_a_lost_authority_is_not_replaced_without_asking(
    folder: Path, lost: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    for name in lost:
        (folder / "keys" / name).unlink()
    before = _contents(folder)
    for command in (["keys", "secure"], ["keys", "init"]):
        assert main([*command, str(folder / "fleet.toml")]) == 2
        assert "--force" in capsys.readouterr().err
        assert _contents(folder) == before
    assert main(["keys", "init", str(folder / "fleet.toml"), "--force"]) == 0


def test_a_key_that_cannot_be_written_is_refused_in_a_sentence(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    key = folder / "keys" / "mav1.key"
    key.unlink()
    (folder / "keys" / "mav1.pem").unlink()
    key.mkdir()

    assert main(["secure", str(folder / "fleet.toml")]) == 2
    assert f"{key} cannot be written" in capsys.readouterr().err


@contextmanager
def _full_disk() -> Iterator[None]:
    """Let files take 16 bytes only, which is less than any key."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (16, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


def _contents(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in (folder / "keys").iterdir()}


def test_a_disk_that_fills_while_a_key_is_written_leaves_no_part_of_a_key(folder: Path) -> None:
    path = folder / "fleet.toml"
    text = path.read_text(encoding="utf-8")
    path.write_text(text.replace("[types.ardrone]", '[types.ardrone]\npx4_version = "1.18"'))
    sign_mavlink(str(path))
    for lost in ("mav1.key", "mav2.mavlink.key"):
        (folder / "keys" / lost).unlink()
    before = _contents(folder)

    refusal = r"\.key cannot be written .* make room"
    with _full_disk(), pytest.raises(ConfigError, match=refusal):
        secure_fleet(str(path), NOW)
    assert _contents(folder) == before
    with _full_disk(), pytest.raises(ConfigError, match=refusal):
        sign_mavlink(str(path))
    assert _contents(folder) == before

    secure_fleet(str(path), NOW)
    fleet = sign_mavlink(str(path))
    assert credentials_of(fleet, "mav1") is not None
    assert mavlink_key(fleet, "mav2") is not None
    assert _contents(folder).keys() == before.keys() | {"mav1.key", "mav2.mavlink.key"}


def test_signed_mavlink_is_refused_for_a_px4_that_cannot_sign_with_the_line_to_write(
    folder: Path,
) -> None:
    path = folder / "fleet.toml"
    before = _contents(folder)
    with pytest.raises(ConfigError, match=r'PX4 v1\.17.* write px4_version = "1\.18"'):
        sign_mavlink(str(path))
    assert _contents(folder) == before


def test_no_vehicle_signs_its_mavlink_before_all_keys_are_made(folder: Path) -> None:
    path = folder / "fleet.toml"
    text = path.read_text(encoding="utf-8")
    path.write_text(text.replace("[types.ardrone]", '[types.ardrone]\npx4_version = "1.18"'))
    (folder / "keys" / "mav1.mavlink.key").write_bytes(b"no key")
    with pytest.raises(ConfigError, match=r"mav1\.mavlink\.key"):
        sign_mavlink(str(path))
    assert not any(each.mavlink_signing for each in load_fleet(path).vehicles.values())


def test_the_place_of_the_keys_is_no_part_of_what_agents_compare(folder: Path) -> None:
    fleet = load_fleet(folder / "fleet.toml")
    data, path, _ = read_toml(folder / "fleet.toml", "fleet file")
    moved = fleet_from_mapping(
        {**data, "fleet": {**data["fleet"], "keys": str(folder / "keys")}}, path=path
    )
    assert moved.keys_folder == fleet.keys_folder
    assert moved.config_hash == fleet.config_hash


def _truncated(folder: Path) -> None:
    file = folder / "keys" / "mav1.pem"
    file.write_bytes(file.read_bytes()[:200])


def _half_a_key(folder: Path) -> None:
    file = folder / "keys" / "mav1.key"
    file.write_bytes(file.read_bytes()[:100])


def _of_an_unknown_curve(folder: Path, name: str) -> None:
    """Write the authority's key with another first number in the curve's 1.2.840.10045.3.1.7."""
    lines = (folder / "keys" / "ca.key").read_text().splitlines()
    content = base64.b64decode("".join(lines[1:-1]))
    curve = bytes.fromhex("06082a8648ce3d030107")
    assert content.count(curve) == 1

    changed = content.replace(curve, bytes.fromhex("06080a8648ce3d030107"))
    text = base64.encodebytes(changed).decode()
    (folder / "keys" / name).write_text(f"{lines[0]}\n{text}{lines[-1]}\n")


def _of_another(folder: Path) -> None:
    for kind in ("pem", "key"):
        shutil.copy(folder / "keys" / f"mav2.{kind}", folder / "keys" / f"mav1.{kind}")


def _mixed(folder: Path) -> None:
    shutil.copy(folder / "keys" / "mav2.key", folder / "keys" / "mav1.key")


def _foreign(folder: Path) -> None:
    assert main(["keys", "init", str(folder / "fleet.toml"), "--force"]) == 0
    shutil.copy(folder / "old" / "ca.pem", folder / "keys" / "ca.pem")


def _issued(days: int) -> Callable[[Path], None]:
    def issue_then(folder: Path) -> None:
        authority = load_authority(load_fleet(folder / "fleet.toml"))
        issue(
            folder / "keys", authority, "mav1", ["127.0.0.1"], NOW + datetime.timedelta(days=days)
        )

    return issue_then


@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (lambda folder: (folder / "keys" / "mav1.pem").unlink(), "is missing: the agent of mav1"),
        (lambda folder: (folder / "keys" / "mav1.key").chmod(0o644), "chmod 600"),
        (_truncated, "is no certificate, or was cut off"),
        (_half_a_key, "is no private key, or was cut off"),
        (
            lambda folder: _of_an_unknown_curve(folder, "mav1.key"),
            "is no private key, or was cut off. Issue it anew",
        ),
        (_of_another, "is the certificate of mav2, not of mav1"),
        (_mixed, "does not belong to"),
        (_foreign, "was not issued by"),
        (_issued(-2000), "has expired on"),
        (_issued(30), "is not valid before"),
    ],
)
def test_what_does_not_fit_is_refused_at_the_start_with_the_remedy(
    folder: Path, spoil: Callable[[Path], object], words: str, capsys: pytest.CaptureFixture[str]
) -> None:
    shutil.copytree(folder / "keys", folder / "old")
    spoil(folder)
    with pytest.raises(ConfigError, match=words):
        credentials_of(load_fleet(folder / "fleet.toml"), "mav1")
    if (folder / "keys" / "mav1.pem").exists():  # else it may well be of another computer
        assert main(["keys", "list", str(folder / "fleet.toml")]) == 1
        assert words in capsys.readouterr().out


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("mav0.pem", "is no certificate, or was cut off. Copy it again, or issue it anew."),
        ("mav1.key", "is no private key, or was cut off. Issue it anew: covey keys renew"),
        ("ca.pem", "is no certificate, or was cut off. Copy it from another computer"),
        ("ca.key", "is no private key, or was cut off. Begin anew: covey keys init"),
    ],
)
@pytest.mark.parametrize("is_locked", [True, False])
def test_a_bus_is_not_locked_with_a_file_that_is_no_key(
    folder: Path, name: str, words: str, is_locked: bool, capsys: pytest.CaptureFixture[str]
) -> None:
    if not is_locked:
        shutil.copy(PAPER, folder / "fleet.toml")
    text = (folder / "fleet.toml").read_bytes()
    (folder / "keys" / name).write_bytes(b"")

    assert main(["keys", "secure", str(folder / "fleet.toml")]) == 2
    refusal = capsys.readouterr().err
    assert f"{name} {words}" in refusal
    assert (folder / "fleet.toml").read_bytes() == text


def test_the_key_of_the_authority_is_refused_if_it_is_none(folder: Path) -> None:
    _of_an_unknown_curve(folder, "ca.key")
    file = folder / "fleet.toml"
    refusal = rf"or was cut off\. Begin anew: covey keys init {file} --force"
    with pytest.raises(ConfigError, match=refusal):
        load_authority(load_fleet(file))


@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (lambda key: key.unlink(), "is not on this computer"),
        (lambda key: shutil.copy(key.with_name("mav1.key"), key), "does not belong to"),
    ],
)
def test_what_replaces_a_lost_authority_is_a_command_with_the_fleet_file(
    folder: Path, spoil: Callable[[Path], object], words: str, capsys: pytest.CaptureFixture[str]
) -> None:
    file = folder / "fleet.toml"
    spoil(folder / "keys" / "ca.key")
    assert main(["keys", "issue", str(file), "mav1"]) == 2
    refusal = capsys.readouterr().err
    assert words in refusal
    assert f"begin anew: covey keys init {file} --force" in refusal


def test_the_key_of_the_authority_is_refused_where_others_can_read_it(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = str(folder / "fleet.toml")
    assert main(["keys", "list", file]) == 0
    assert "it makes new nodes" in capsys.readouterr().out

    key = folder / "keys" / "ca.key"
    key.chmod(0o640)
    with pytest.raises(ConfigError, match=f"chmod 600 {key}"):
        load_authority(load_fleet(file))
    assert main(["keys", "list", file]) == 1
    assert "chmod 600" in capsys.readouterr().out
    assert main(["keys", "issue", file, "mav1"]) == 2
    assert main(["doctor", file]) == 1
    assert "key of the authority" in capsys.readouterr().out

    key.unlink()
    assert main(["keys", "list", file]) == 0
    assert "ca.key       is not on this computer" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("command", "word"), [("init", "--force"), ("issue", "mav1"), ("renew", None)]
)
def test_git_leaves_the_folders_of_keys_out(folder: Path, command: str, word: str | None) -> None:
    (folder / "keys" / ".gitignore").unlink(missing_ok=True)  # as earlier versions made them
    words = [] if word is None else [word]
    assert main(["keys", command, str(folder / "fleet.toml"), *words]) == 0
    subprocess.run(["git", "init", "-q", folder], check=True)
    status = subprocess.run(
        ["git", "-C", folder, "status", "--porcelain", "-uall"],
        capture_output=True,
        text=True,
        check=True,
    )
    assert status.stdout.split() == ["??", "fleet.toml"]


def test_a_certificate_whose_key_is_elsewhere_is_listed_so(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (folder / "keys" / "mav1.key").unlink()
    assert main(["keys", "list", str(folder / "fleet.toml")]) == 0
    assert capsys.readouterr().out.count("its key is not on this computer") == 1


def test_a_new_authority_locks_out_every_older_key(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = str(folder / "fleet.toml")
    assert main(["keys", "init", file]) == 2  # not by accident
    old = {path.name: path.read_bytes() for path in (folder / "keys").iterdir()}
    assert main(["keys", "init", file, "--force"]) == 0
    keys = [path for path in (folder / "keys").iterdir() if path.name != ".gitignore"]
    assert all(path.read_bytes() != old[path.name] for path in keys)
    assert main(["keys", "list", file]) == 0
    (folder / "keys" / "mav2.pem").write_bytes(old["mav2.pem"])
    assert main(["keys", "list", file]) == 1
    assert "was not issued by" in capsys.readouterr().out


def test_examples_and_unknown_nodes_are_refused(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["secure", "paper"]) == 2
    assert "Copy it" in capsys.readouterr().err
    assert main(["keys", "issue", str(folder / "fleet.toml"), "mav9"]) == 2
    assert "'mav9' is no node" in capsys.readouterr().err


@pytest.mark.parametrize("command", [["init"], ["init", "--force"], ["issue", "mav1"], ["renew"]])
def test_no_keys_are_made_for_a_bus_that_would_not_use_them(
    tmp_path: Path, command: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "fleet.toml"
    shutil.copy(PAPER, file)
    name, *words = command
    assert main(["keys", name, str(file), *words]) == 2
    assert f"has no keys. Lock it: covey keys secure {file}" in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == [file]


@pytest.mark.parametrize("command", [["init", "--force"], ["issue", "mav1"], ["renew"]])
def test_a_bus_that_does_not_use_its_keys_is_called_open(
    folder: Path, command: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    file = folder / "fleet.toml"
    shutil.copy(PAPER, file)
    name, *words = command
    assert main(["keys", name, str(file), *words]) == 0
    assert f"The bus is still open to everybody. Lock it: covey keys secure {file}" in (
        capsys.readouterr().out
    )


def _fleet(**changes: str) -> FleetConfig:
    data, path, _ = read_toml(PAPER, "fleet file")
    for name, endpoint in changes.items():
        data["vehicles"][name]["agent"] = endpoint
    return fleet_from_mapping(data, path=path)


def test_endpoints_that_contradict_each_other_are_refused() -> None:
    with pytest.raises(ConfigError, match="among endpoints with keys"):
        _fleet(mav1="quic/127.0.0.1:7461")
    with pytest.raises(ConfigError, match="name the one at which they reach"):
        _fleet(mav1="tcp/0.0.0.0:7461")


def test_a_vehicle_that_moved_to_another_address_needs_a_certificate_for_it(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = folder / "fleet.toml"
    text = file.read_text(encoding="utf-8")
    agent = load_fleet(file).vehicles["mav1"].agent
    file.write_text(text.replace(agent, agent.replace("127.0.0.1", "10.0.0.21")), encoding="utf-8")
    with pytest.raises(
        ConfigError, match=r"is for 127.0.0.1, but the fleet file has mav1 at 10.0.0.21"
    ):
        credentials_of(load_fleet(file), "mav1")
    assert main(["keys", "list", str(file)]) == 1
    assert "covey keys issue FLEET mav1" in capsys.readouterr().out
    assert main(["keys", "issue", str(file), "mav1"]) == 0
    assert credentials_of(load_fleet(file), "mav1") is not None
