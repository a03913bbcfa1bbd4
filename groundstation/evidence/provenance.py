"""The provenance of evidence: versions, machine, hashes of files, fingerprints of certificates.

Private keys are not read. A certificate is public, and its fingerprint identifies it.
"""

from __future__ import annotations

import hashlib
import importlib.util
import os
import platform
import sys
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import msgspec
from cryptography.hazmat.primitives import hashes

from groundstation.formations.slots import formation_files
from groundstation.mission_files.mission import Mission
from onboard.config.fleet import ConfigError, FleetConfig
from onboard.security.certificates import read_certificate
from onboard.security.credentials import files_of
from onboard.security.node_roles import NodeRole

_LIBRARIES = ("covey", "numpy", "numba", "llvmlite", "msgspec")
_PACKAGES = ("onboard", "groundstation", "sitl")
_CPU_FILE = Path("/proc/cpuinfo")


class Provenance(msgspec.Struct, frozen=True, kw_only=True):
    """The software, machine and files with which evidence was made."""

    versions: dict[str, str]
    source: str  # SHA-256 of Covey's own files
    machine: dict[str, str]
    files: dict[str, str]  # path of a file, from the mission's folder -> its SHA-256
    config_hash: str  # hash of the fleet file's values
    certificates: dict[str, str]  # name of a certificate on this computer -> its SHA-256
    has_keys: bool = False  # whether the bus of the fleet is locked


def provenance(fleet_path: Path, mission_path: Path, mission: Mission) -> Provenance:
    """Return the provenance of evidence for a fleet and a mission that is made on this machine."""
    return Provenance(
        versions=_versions(),
        source=source_hash(),
        machine=_machine(),
        files=_files(fleet_path, mission_path, mission),
        config_hash=mission.fleet.config_hash,
        certificates=_certificates(mission.fleet),
        has_keys=mission.fleet.has_keys,
    )


def _versions() -> dict[str, str]:
    versions = {"python": platform.python_version()}
    for name in _LIBRARIES:
        try:
            versions[name] = version(name)
        except PackageNotFoundError:
            versions[name] = "not installed"
    return versions


def source_hash() -> str:
    """Return the SHA-256 of all Python and TOML files of the Covey that runs here."""
    digest = hashlib.sha256()
    for package in _PACKAGES:
        spec = importlib.util.find_spec(package)
        if spec is None or not spec.submodule_search_locations:
            continue
        root = Path(spec.submodule_search_locations[0])
        for path in sorted(root.rglob("*")):
            is_source = path.suffix in (".py", ".toml") and "examples" not in path.parts
            if is_source and path.is_file():
                name = path.relative_to(root).as_posix()
                digest.update(f"{package}/{name}\n".encode())
                digest.update(hashlib.sha256(path.read_bytes()).digest())
    return digest.hexdigest()


def _machine() -> dict[str, str]:
    return {
        "system": f"{platform.system()} {platform.release()}",
        "architecture": platform.machine(),
        "processor": _processor(),
        "cores": str(os.cpu_count() or 0),
        "byte order": sys.byteorder,
    }


def _processor() -> str:
    try:
        lines = _CPU_FILE.read_text(encoding="utf-8", errors="replace").splitlines()
    except OSError:
        return platform.processor() or "not known"
    for line in lines:
        name, _, value = line.partition(":")
        if name.strip() == "model name":
            return value.strip()
    return platform.processor() or "not known"


def _files(fleet_path: Path, mission_path: Path, mission: Mission) -> dict[str, str]:
    """Return the hashes of fleet file, mission file, and the files of paths and formations.

    Files are named as seen from the mission's folder: two folders may hold files of one name.
    """
    folder = mission_path.parent
    paths = [folder / name for name in sorted(mission.paths)]
    formations = [Path(file) for file in formation_files(mission.fleet)]

    hash_by_name = {}
    for path in [fleet_path, mission_path, *paths, *formations]:
        if path.is_file():
            name = os.path.relpath(path, folder)
            hash_by_name[name] = hashlib.sha256(path.read_bytes()).hexdigest()
    return hash_by_name


def _certificates(fleet: FleetConfig) -> dict[str, str]:
    """Return the fingerprints of the certificates of a fleet's bus that are on this computer."""
    if not fleet.has_keys:
        return {}

    fingerprints = {}
    for node in (NodeRole.GROUND.value, *fleet.enabled_names):
        authority, own, _ = files_of(node)
        for name in (authority, own):
            try:
                certificate = read_certificate(os.path.join(fleet.keys_folder, name))
            except ConfigError:
                continue  # a ground does not need the certificates of all vehicles
            fingerprints[name] = certificate.fingerprint(hashes.SHA256()).hex()
    return fingerprints
