"""Checks of the keys of a fleet's bus: the files on this computer, and the keys that nodes use."""

from __future__ import annotations

import datetime

from groundstation.keys.authority import folder_of, has_authority_key, nodes_of
from groundstation.keys.running import running_authorities
from groundstation.network.diagnosis import Diagnosis, Grade, graded
from onboard.config.fleet import ConfigError, FleetConfig
from onboard.security.certificate_times import SOON_S, end_words
from onboard.security.certificates import read_certificate
from onboard.security.credentials import credentials_of, files_of


def key_checks(fleet: FleetConfig) -> list[Diagnosis]:
    """Return the findings about the keys on this computer."""
    if not fleet.has_keys:
        return [
            Diagnosis(
                "keys",
                Grade.OK,
                "This fleet's bus has none. On one computer it needs none.",
                "On a network: covey keys secure FLEET",
            )
        ]

    now = datetime.datetime.now(datetime.UTC)
    folder = folder_of(fleet)
    diagnoses = []
    expiry: dict[str, datetime.datetime] = {}  # node whose key is here and valid -> its expiry
    for node in nodes_of(fleet):
        _, certificate_name, key_name = files_of(node)
        if not (folder / key_name).exists():
            continue
        try:
            credentials_of(fleet, node, now)
            expiry[node] = read_certificate(str(folder / certificate_name)).not_valid_after_utc
        except ConfigError as error:
            diagnoses.append(Diagnosis(f"keys of {node}", Grade.FAIL, str(error)))

    try:
        has_authority_key(fleet)
    except ConfigError as error:
        diagnoses.append(Diagnosis("key of the authority", Grade.FAIL, str(error)))

    if not expiry:
        sentence = f"No key in {folder} is good."
        diagnoses.append(Diagnosis("keys", Grade.FAIL, sentence, "Copy this node's: docs/keys.md"))
        return diagnoses

    first_to_expire = min(expiry, key=lambda node: expiry[node])
    words = end_words(expiry[first_to_expire], now)
    is_far_off = (expiry[first_to_expire] - now).total_seconds() > SOON_S
    diagnoses.append(
        graded(
            "keys",
            is_far_off,
            f"Here are those of {', '.join(expiry)};"
            f" the first to expire is {first_to_expire}'s, {words}.",
            "covey keys renew FLEET, and copy them",
        )
    )
    return diagnoses


def authority_check(fleet: FleetConfig) -> Diagnosis:
    """Return the finding about nodes that still run with an authority that was replaced."""
    former = [
        node for node, authority in running_authorities(fleet).items() if authority == "former"
    ]
    names = ", ".join(former) or "none of those that answer"
    return graded(
        "authority",
        not former,
        f"Run on with a former authority: {names}.",
        "Copy their new files, and start them anew: docs/keys.md",
        bad=Grade.FAIL,
    )
