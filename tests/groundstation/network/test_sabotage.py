"""``covey check attack`` notices when a defence is switched off: each sabotage lets its tries in.

The agents of the attacked copy are processes of their own. Each of them loads a file with the
sabotage when Python starts (``sitecustomize``), so that the code that flies is the code that is
tested, less one door.
"""

from __future__ import annotations

import json
import textwrap
from pathlib import Path
from typing import NamedTuple

import pytest

from groundstation.cli import main
from groundstation.network.denials import DENIED
from onboard.security.node_roles import GRANTS, NodeRole


class Sabotage(NamedTuple):
    """A defence that is switched off, and the tries that get in then."""

    patch: str  # Python that every process of the copy runs when it starts
    only: str  # the part of the names of the tries that are made
    gets_in: tuple[str, ...]  # parts of the names of those that get in


SABOTAGES = {
    "the signature of an order": Sabotage(
        patch="""
            from onboard.security import order_signature
            order_signature.SealCheck.refusal = lambda *arguments: None
        """,
        only="an order",
        gets_in=(
            "without a signature",
            "one byte was changed",
            "signed for another vehicle",
            "a viewer has signed",
        ),
    ),
    "the age of an order": Sabotage(
        patch="""
            from onboard.agent import order_gate
            order_gate.OrderGate.refusal = lambda *arguments, **options: None
        """,
        only="kept for",
        gets_in=("an order that was kept for 10 s", "a hold that was kept for 40 s"),
    ),
    "an order once": Sabotage(
        patch="""
            from onboard.agent import order_gate, order_intake
            order_gate.OrderGate.refusal = lambda *arguments, **options: None
        """,
        only="sent again",
        gets_in=("a recorded order, sent again",),
    ),
    "what a role may publish": Sabotage(
        patch="""
            from onboard.bus.topics import Topic
            from onboard.security.node_roles import GRANTS
            for grant in GRANTS.values():
                for topic in Topic:
                    grant.publishes[topic] = ("*",)
        """,
        only="publishes what its role may not",
        gets_in=(
            "mav2's key",
            "ground's key",
            "viewer's key",
            "mocap's key",
            "sitl's key",
        ),
    ),
    "what a role may order": Sabotage(
        patch="""
            from onboard.bus.topics import Topic
            from onboard.security import order_signature
            from onboard.security.node_roles import GRANTS
            for grant in GRANTS.values():
                grant.asks[Topic.ORDER] = ("*",)
            order_signature.SealCheck.refusal = lambda *arguments: None
        """,
        only="key: orders hold",
        gets_in=("a viewer's key", "a mocap's key", "a sitl's key", "mav2's key"),
    ),
    "who opens a link": Sabotage(
        patch="""
            from onboard.bus import settings
            from onboard.security import access_control, credentials, order_signature
            real = settings._security
            settings._security = lambda given: [
                (name, value)
                for name, value in real(given)
                if name != "access_control" and not name.endswith("enable_mtls")
            ]
            order_signature.SealCheck.refusal = lambda *arguments: None
        """,
        only="without a certificate",
        gets_in=("publishes a vehicle's state",),
    ),
}


@pytest.mark.long
@pytest.mark.timeout(600)
@pytest.mark.parametrize("name", SABOTAGES)
def test_a_defence_that_is_switched_off_is_noticed(
    name: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    sabotage = SABOTAGES[name]
    patch = textwrap.dedent(sabotage.patch)
    (tmp_path / "sitecustomize.py").write_text(patch, encoding="utf-8")
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))

    status = main(["attack", "paper", "--json", "--only", sabotage.only])

    report = json.loads(capsys.readouterr().out)
    got_in = [one["name"] for one in report["tries"] if one["with_keys"]]
    for part in sabotage.gets_in:
        assert any(part in one for one in got_in), (part, report["tries"])
    assert status == 1


def test_no_role_is_granted_what_its_key_must_not_publish() -> None:
    for role in NodeRole:
        granted = GRANTS[role].publishes
        assert not DENIED[role].as_itself & granted.keys(), role
        of_any_name = {topic for topic, names in granted.items() if "*" in names}
        assert not DENIED[role].as_another & of_any_name, role
