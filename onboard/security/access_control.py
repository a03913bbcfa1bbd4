"""Converts the table of roles to zenoh's access control. Pure.

Zenoh's access control consists of rules, and of policies that assign rules to certificate holders.
A rule allows some kinds of messages on some keys of the bus. Each link checks incoming messages,
and drops those that no rule allows. All outgoing messages are allowed, because the receiver checks
them.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from onboard.bus.topics import Topic, key
from onboard.security.node_roles import GRANTS, NODES, ROUTER, Grant, NodeRole

_Rule = dict[str, object]  # one entry of zenoh's ``access_control.rules``

_OUT = "out"  # id of the rule that allows all outgoing messages
_ALL_MESSAGES = (
    "put",
    "delete",
    "declare_subscriber",
    "query",
    "reply",
    "declare_queryable",
    "liveliness_token",
    "liveliness_query",
    "declare_liveliness_subscriber",
)


def access_control(fleets: Mapping[str, Iterable[str]], *, has_router: bool) -> dict[str, object]:
    """Return zenoh's ``access_control``: the messages accepted from the holder of each certificate.

    Args:
        fleets: key prefix of a fleet, ``covey/<fleet name>``, -> names of its vehicles. Only a
            router may have several fleets.
        has_router: whether the fleets have routers, which forward messages of other nodes.
    """
    rules: list[_Rule] = [_rule(_OUT, _ALL_MESSAGES, ["**"], "egress")]
    rule_ids: dict[str, list[object]] = {}  # holder of a certificate -> ids of its rules

    for namespace, vehicles in fleets.items():
        holders = [(name, NodeRole.VEHICLE) for name in vehicles]
        holders += [(role.value, role) for role in NODES]

        for name, role in holders:
            own_rules = _rules_of(namespace, name, GRANTS[role])
            rules += own_rules
            rule_ids.setdefault(name, [_OUT]).extend(rule["id"] for rule in own_rules)

        if has_router:
            rule = _rule(f"{namespace} {ROUTER}", _ALL_MESSAGES, [f"{namespace}/**"], "ingress")
            rules.append(rule)
            rule_ids.setdefault(ROUTER, [_OUT]).append(rule["id"])

    subjects = [{"id": name, "cert_common_names": [name]} for name in rule_ids]
    policies = [{"rules": ids, "subjects": [name]} for name, ids in rule_ids.items()]
    return {
        "enabled": True,
        "default_permission": "deny",
        "rules": rules,
        "subjects": subjects,
        "policies": policies,
    }


def _rules_of(namespace: str, name: str, grant: Grant) -> list[_Rule]:
    """Return the rules for the holder of one certificate, one for each kind of access."""

    def keys(patterns_of: Mapping[Topic, tuple[str, ...]]) -> list[str]:
        """Return the keys of the topics with these patterns of names."""
        expressions = []
        for topic, patterns in patterns_of.items():
            for pattern in patterns:
                expressions.append(key(namespace, topic, pattern.format(own=name)))
        return expressions

    # the key of a liveliness token ends with its name and a number that the node chooses
    tokens = [key(namespace, Topic.ALIVE, f"{token.format(own=name)}/*") for token in grant.tokens]
    reads = [key(namespace, topic, "**") for topic in sorted(grant.reads)]

    # kinds of messages, and the keys on which they are allowed
    accesses: list[tuple[tuple[str, ...], list[str]]] = [
        (("put",), keys(grant.publishes)),
        (("reply", "declare_queryable"), keys(grant.answers)),
        (("query",), keys(grant.asks)),
        (("liveliness_token",), tokens),
        (("declare_subscriber", "declare_liveliness_subscriber", "liveliness_query"), reads),
    ]
    rules = []
    for number, (messages, expressions) in enumerate(accesses):
        if expressions:
            rules.append(_rule(f"{namespace} {name} {number}", messages, expressions, "ingress"))
    return rules


def _rule(id_: str, messages: Iterable[str], expressions: list[str], flow: str) -> _Rule:
    return {
        "id": id_,
        "messages": list(messages),
        "flows": [flow],
        "permission": "allow",
        "key_exprs": expressions,
    }
