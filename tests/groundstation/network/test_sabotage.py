"""Each proof of docs/threats.md turns red when its defence is switched off.

Where ``covey check attack`` is the proof, the sabotage lets its tries in: the agents of the
attacked copy are processes of their own. Where tests are the proof, they fail. Each process loads a
file with the sabotage when Python starts (``sitecustomize``), so that the code that flies is the
code that is tested, less one door.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import textwrap
from pathlib import Path
from typing import NamedTuple

import pytest

from groundstation.network.denials import DENIED
from onboard.security.node_roles import GRANTS, NodeRole

ROOT = Path(__file__).parents[3]


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
            "corrections's key",
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
        gets_in=(
            "a viewer's key",
            "a mocap's key",
            "a corrections's key",
            "a sitl's key",
            "mav2's key",
        ),
    ),
    "who opens a link": Sabotage(
        patch="""
            from onboard.bus import zenoh_settings
            from onboard.security import access_control, credentials, order_signature
            real = zenoh_settings._security
            zenoh_settings._security = lambda given: [
                (name, value)
                for name, value in real(given)
                if name != "access_control" and not name.endswith("enable_mtls")
            ]
            order_signature.SealCheck.refusal = lambda *arguments: None
        """,
        only="without a certificate",
        gets_in=("publishes a vehicle's state", "publishes corrections of a false base"),
    ),
}


class SabotagedTest(NamedTuple):
    """A defence that is switched off, and a test that fails then."""

    patch: str
    test: str  # file and name
    fails: int = 1  # of its cases, at least


_LOCKED_BUS = "tests/onboard/security/test_locked_bus.py"
_CORRECTIONS = "tests/onboard/corrections/test_intake.py"
_MAVLINK_RELAY = "tests/onboard/px4/test_mavlink_relay.py"

SABOTAGED_TESTS = {
    "the signature of an order, on the bus": SabotagedTest(
        patch="""
            from onboard.security import order_signature
            order_signature.SealCheck.refusal = lambda *arguments: None
        """,
        test=f"{_LOCKED_BUS}::test_an_order_of_the_grounds_own_link_is_taken_only_as_the_ground"
        "_has_signed_it",
        fails=6,
    ),
    "what a role may publish, on the bus": SabotagedTest(
        patch="""
            from onboard.bus.topics import Topic
            from onboard.security.node_roles import GRANTS
            for grant in GRANTS.values():
                for topic in Topic:
                    grant.publishes[topic] = ("*",)
        """,
        test=f"{_LOCKED_BUS}::test_what_each_holder_of_a_key_may_publish_read_and_order",
        fails=5,
    ),
    "one right too many": SabotagedTest(
        patch="""
            from onboard.bus.topics import Topic
            from onboard.security.node_roles import GRANTS, NodeRole
            GRANTS[NodeRole.VEHICLE].publishes[Topic.STATE] = ("*",)
        """,
        test=f"{_LOCKED_BUS}::test_what_each_holder_of_a_key_may_publish_read_and_order",
    ),
    "who opens a link, on the bus": SabotagedTest(
        patch="""
            from onboard.bus import zenoh_settings
            zenoh_settings._security = lambda given: []
        """,
        test=f"{_LOCKED_BUS}::test_nobody_without_a_key_of_this_authority_is_heard_or_hears",
    ),
    "the signature of an order": SabotagedTest(
        patch="""
            from onboard.security import order_signature
            order_signature.SealCheck.refusal = lambda *arguments: None
        """,
        test="tests/onboard/security/test_order_signature.py",
        fails=4,
    ),
    "the limit of false signatures": SabotagedTest(
        patch="""
            from onboard.security.order_signature import SealCheck
            fault = SealCheck._fault
            SealCheck._fault_unless_flood = lambda self, node, *order: fault(self, *order)
        """,
        test="tests/onboard/security/test_order_signature.py::test_false_orders_in_a_flood_are_not"
        "_looked_at_and_keep_no_true_ground_from_ordering",
    ),
    "an order once, new, and for one start": SabotagedTest(
        patch="""
            from onboard.agent import order_gate
            order_gate.OrderGate.refusal = lambda *arguments, **options: None
        """,
        test="tests/onboard/agent/test_order_gate.py",
        fails=5,
    ),
    "a word that cannot be true": SabotagedTest(
        patch="""
            from onboard.neighbours.plausibility import PlausibilityMonitor
            PlausibilityMonitor.update = lambda *arguments: None
        """,
        test="tests/sitl/lockstep/test_liars.py::test_a_liar_is_named_and_kept_off",
        fails=3,
    ),
    "where a base may be": SabotagedTest(
        patch="""
            from onboard.corrections import base_watch
            base_watch.BaseWatch._judge = lambda *arguments, **options: base_watch.FINE
        """,
        test=_CORRECTIONS,
        fails=7,
    ),
    "one source of corrections": SabotagedTest(
        patch="""
            from onboard.corrections.intake import CorrectionsIntake
            CorrectionsIntake._is_of_the_source = lambda *arguments: True
        """,
        test=f"{_CORRECTIONS}::test_a_second_source_is_not_mixed_in_until_the_first_is_gone",
    ),
    "the checksum of a frame": SabotagedTest(
        patch="""
            from onboard.corrections.relay import framing
            framing.calc_crc24q = lambda data: 0
        """,
        test="tests/onboard/corrections/test_rtcm.py",
        fails=2,
    ),
    "an agent passes on what reads logs, and nothing else": SabotagedTest(
        patch="""
            from onboard.px4 import log_requests
            log_requests._only_reads_logs = lambda payload: True
        """,
        test="tests/onboard/px4/test_log_requests.py",
        fails=21,
    ),
    "nobody waits for who reads nothing": SabotagedTest(
        patch="""
            from onboard.bus import sockets
            sockets.let_all_close_at_once = lambda: 0
        """,
        test="tests/onboard/bus/test_hung_peers.py::test_listeners_that_hang_hold_up_nobody",
        fails=2,
    ),
    "PX4's own ids": SabotagedTest(
        patch="""
            from onboard.px4.mavlink_relay import MavlinkRelay
            judge = MavlinkRelay._judge
            def every_id(self, packet, address):
                own = packet._replace(system_id=self._ids.system, component_id=1)
                judge(self, own, address)
            MavlinkRelay._judge = every_id
        """,
        test=f"{_MAVLINK_RELAY}::test_only_the_first_autopilot_with_the_right_ids_is_heard_and_all"
        "_else_is_counted",
    ),
    "PX4's own address": SabotagedTest(
        patch="""
            from onboard.px4 import mavlink_relay
            mavlink_relay._ANOTHER_NS = -1
        """,
        test=f"{_MAVLINK_RELAY}::test_only_the_first_autopilot_with_the_right_ids_is_heard_and_all"
        "_else_is_counted",
    ),
    "the key of MAVLink": SabotagedTest(
        patch="""
            from onboard.px4.mavlink_relay import MavlinkRelay
            MavlinkRelay._is_fresh = lambda *arguments: True
        """,
        test=f"{_MAVLINK_RELAY}::test_a_relay_with_a_key_hears_what_is_freshly_signed_and_signs"
        "_what_it_sends",
    ),
    "a new authority": SabotagedTest(
        patch="""
            from groundstation.keys import secured_fleet
            def renew_with_the_former(fleet, now):
                former = secured_fleet.load_authority(fleet)
                secured_fleet.issue_all(fleet, former, secured_fleet.nodes_of(fleet), now)
                return secured_fleet.nodes_of(fleet)
            secured_fleet.renew_authority = renew_with_the_former
        """,
        test="tests/groundstation/keys/test_keys.py::test_a_new_authority_locks_out_every_older_key",
    ),
}


@pytest.mark.long
@pytest.mark.timeout(600)
@pytest.mark.parametrize("name", SABOTAGES)
def test_a_defence_that_is_switched_off_is_noticed(name: str, tmp_path: Path) -> None:
    sabotage = SABOTAGES[name]
    # the command itself is sabotaged, too: among its tries it hears what arrives, as an agent does
    run = subprocess.run(
        [sys.executable, "-m", "groundstation", "attack", "paper", "--json", "--only",
         sabotage.only],
        cwd=ROOT,
        env={**os.environ, "PYTHONPATH": _sabotaged(sabotage.patch, tmp_path)},
        capture_output=True,
        text=True,
        check=False,
    )  # fmt: skip
    report = json.loads(run.stdout)
    got_in = [one["name"] for one in report["tries"] if one["with_keys"]]
    for part in sabotage.gets_in:
        assert any(part in one for one in got_in), (part, report["tries"])
    assert run.returncode == 1


@pytest.mark.long
@pytest.mark.timeout(600)
@pytest.mark.parametrize("name", SABOTAGED_TESTS)
def test_a_test_of_a_defence_fails_without_it(name: str, tmp_path: Path) -> None:
    sabotaged = SABOTAGED_TESTS[name]
    run = subprocess.run(
        [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "-rf", sabotaged.test],
        cwd=ROOT,
        env={**os.environ, "PYTHONPATH": _sabotaged(sabotaged.patch, tmp_path)},
        capture_output=True,
        text=True,
        check=False,
    )  # fmt: skip
    failed = [line for line in run.stdout.splitlines() if line.startswith("FAILED ")]
    assert len(failed) >= sabotaged.fails, run.stdout[-3000:]


def _sabotaged(patch: str, folder: Path) -> str:
    """Return a folder for PYTHONPATH whose code is run by every process of Python."""
    (folder / "sitecustomize.py").write_text(textwrap.dedent(patch), encoding="utf-8")
    return str(folder)


def test_no_role_is_granted_what_its_key_must_not_publish() -> None:
    for role in NodeRole:
        granted = GRANTS[role].publishes
        assert not DENIED[role].as_itself & granted.keys(), role
        of_any_name = {topic for topic, names in granted.items() if "*" in names}
        assert not DENIED[role].as_another & of_any_name, role
