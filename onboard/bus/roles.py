"""Who may say what on a bus with keys: one table of role and topic, and the access control made
from it. Pure.

A node's role is the common name of its certificate: a vehicle's name, or one of the names below.
Each node checks what comes in over each of its links; what is not granted there is dropped before
it is read. A link whose certificate is of another authority is not opened at all.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from enum import StrEnum

from onboard.bus.topics import TOPICS, Delivery, Topic, key


class Role(StrEnum):
    """Kind of node; of those that are no vehicle the value is the common name of the certificate."""

    VEHICLE = "vehicle"
    GROUND = "ground"  # orders, and reads all
    VIEWER = "viewer"  # reads all
    MOCAP = "mocap"  # publishes poses
    EMULATOR = "sitl"  # publishes poses and ground truth of what it emulates


# common name of a router, which has no role: it passes on what the others say, each within its own
ROUTER = "router"


@dataclass(frozen=True, slots=True)
class Grant:
    """What one role may do.

    Names: ``{own}`` is the vehicle's own, ``*`` any, ``x$*`` any that begins with x.
    """

    publishes: Mapping[Topic, tuple[str, ...]]
    answers: Mapping[Topic, tuple[str, ...]]
    asks: Mapping[Topic, tuple[str, ...]]
    tokens: tuple[str, ...]  # first words of its names in ``alive``
    reads: frozenset[Topic]


_SAMPLES = frozenset(topic for topic, spec in TOPICS.items() if spec.delivery is not Delivery.QUERY)
_OWN, _ANY = "{own}", ("*",)
GRANTS: dict[Role, Grant] = {
    Role.VEHICLE: Grant(
        publishes=dict.fromkeys(
            (
                *(Topic.STATE, Topic.FAR, Topic.TELEMETRY, Topic.SLOW_TELEMETRY),
                *(Topic.TICK, Topic.EVENT, Topic.PREFLIGHT, Topic.CLOCK),
            ),
            (_OWN,),
        ),
        answers={Topic.ORDER: (_OWN,)},
        asks={},
        tokens=(_OWN,),
        reads=frozenset(
            (
                Topic.STATE,
                Topic.FAR,
                Topic.SLOW_TELEMETRY,
                Topic.MOCAP,
                Topic.ALL_POSES,
                Topic.CLOCK,
                Topic.ALIVE,
            )
        ),
    ),
    Role.GROUND: Grant(
        publishes={Topic.EVENT: _ANY, Topic.LIGHT: _ANY, Topic.CLOCK: ("ground$*", "watcher$*")},
        answers={},
        asks={Topic.ORDER: _ANY, Topic.SIM: _ANY},
        tokens=("ground$*", "watcher$*", "recorder$*", "operator.$*", "asks.$*", "keeps.$*"),
        reads=_SAMPLES,
    ),
    Role.VIEWER: Grant(
        publishes={Topic.CLOCK: ("watcher$*",)},
        answers={},
        asks={},
        tokens=("watcher$*",),
        reads=_SAMPLES,
    ),
    Role.MOCAP: Grant(
        publishes={Topic.MOCAP: _ANY, Topic.ALL_POSES: _ANY, Topic.CLOCK: ("mocap$*",)},
        answers={},
        asks={},
        tokens=("mocap$*",),
        # ticks: covey mocap --check
        reads=frozenset((Topic.MOCAP, Topic.TICK, Topic.CLOCK, Topic.ALIVE)),
    ),
    Role.EMULATOR: Grant(
        publishes={
            Topic.MOCAP: _ANY,
            Topic.ALL_POSES: _ANY,
            Topic.TRUTH: _ANY,
            Topic.CLOCK: ("sitl$*",),
        },
        answers={Topic.SIM: _ANY},
        asks={},
        tokens=("sitl$*",),
        reads=frozenset((Topic.CLOCK, Topic.ALIVE)),
    ),
}
NODES: tuple[Role, ...] = tuple(role for role in Role if role is not Role.VEHICLE)
_ALL_MESSAGES = (
    *("put", "delete", "declare_subscriber", "query", "reply", "declare_queryable"),
    *("liveliness_token", "liveliness_query", "declare_liveliness_subscriber"),
)


def access_control(fleets: Mapping[str, Iterable[str]], *, has_router: bool) -> dict[str, object]:
    """Return zenoh's ``access_control``: what may come in from the holder of which certificate.

    Args:
        fleets: key prefix, ``covey/<fleet name>``, -> names of the vehicles; several for a router
            of several fleets.
        has_router: whether routers pass on messages of others.
    """
    rules: list[dict[str, object]] = [_rule("out", _ALL_MESSAGES, ["**"], "egress")]
    granted: dict[str, list[object]] = {}  # holder -> ids of rules
    for namespace, vehicles in fleets.items():
        for name, role in (
            *((name, Role.VEHICLE) for name in vehicles),
            *((role.value, role) for role in NODES),
        ):
            own = list(_rules_of(namespace, name, GRANTS[role]))
            rules += own
            granted.setdefault(name, ["out"]).extend(rule["id"] for rule in own)
        if has_router:
            rules.append(
                _rule(f"{namespace} {ROUTER}", _ALL_MESSAGES, [f"{namespace}/**"], "ingress")
            )
            granted.setdefault(ROUTER, ["out"]).append(rules[-1]["id"])
    subjects = [{"id": name, "cert_common_names": [name]} for name in granted]
    policies = [{"rules": ids, "subjects": [name]} for name, ids in granted.items()]
    return {
        "enabled": True,
        "default_permission": "deny",
        "rules": rules,
        "subjects": subjects,
        "policies": policies,
    }


def _rules_of(namespace: str, name: str, grant: Grant) -> Iterator[dict[str, object]]:
    def keys(names: Mapping[Topic, tuple[str, ...]]) -> list[str]:
        return [
            key(namespace, topic, one.format(own=name))
            for topic, patterns in names.items()
            for one in patterns
        ]

    tokens = [key(namespace, Topic.ALIVE, f"{first.format(own=name)}/*") for first in grant.tokens]
    reads = [key(namespace, topic, "**") for topic in sorted(grant.reads)]
    for number, (messages, expressions) in enumerate(
        (
            (("put",), keys(grant.publishes)),
            (("reply", "declare_queryable"), keys(grant.answers)),
            (("query",), keys(grant.asks)),
            (("liveliness_token",), tokens),
            (("declare_subscriber", "declare_liveliness_subscriber", "liveliness_query"), reads),
        )
    ):
        if expressions:
            yield _rule(f"{namespace} {name} {number}", messages, expressions, "ingress")


def _rule(
    name: str, messages: Iterable[str], expressions: list[str], flow: str
) -> dict[str, object]:
    return {
        "id": name,
        "messages": list(messages),
        "flows": [flow],
        "permission": "allow",
        "key_exprs": expressions,
    }
