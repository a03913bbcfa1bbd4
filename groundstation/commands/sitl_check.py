"""``covey check endpoint``: does a MAVLink endpoint behave as a real PX4, fact by fact?

Examples:
  covey check endpoint udpin://127.0.0.1:14540
  covey check endpoint udpin://127.0.0.1:14540 --only quirk.heartbeat 'param.*' --json
  covey check endpoint --list

Exit status: 0 all agree; 1 some differ; 2 wrong input; 10 nobody answered; 130 interrupted. Boot
facts need a vehicle that is started while the check already waits.
"""

from __future__ import annotations

import contextlib
import re
import sys
from json import dumps
from pathlib import Path
from typing import Annotated, Literal

from cyclopts import Parameter

from groundstation.commands.parameters import Seconds
from onboard.config.fleet import ConfigError
from onboard.exit_status import EXIT_FAILED, EXIT_INTERRUPTED, EXIT_NO_ANSWER, EXIT_OK
from onboard.security.mavlink_key import read_key
from sitl.conformance.endpoint import UdpPort
from sitl.conformance.facts import (
    VERSIONS,
    Fact,
    FactReport,
    FactResult,
    FactVerdict,
    facts_of,
    matching,
)
from sitl.conformance.suite import FACTS, NobodyAnsweredError, Terms, check

_ENDPOINT = re.compile(r"(?P<kind>udpin|udpout)://(?P<host>[^:/]*):(?P<port>\d{1,5})")
_LONGEST_S = 600.0
_MARKS = {
    FactVerdict.AGREES: "  agrees ",
    FactVerdict.DIFFERS: "X DIFFERS",
    FactVerdict.SKIPPED: "- skipped",
}


def sitl_check(
    endpoint: Annotated[str | None, Parameter(name="ENDPOINT")] = None,
    /,
    *,
    gcs: Annotated[str | None, Parameter(metavar="ENDPOINT")] = None,
    sih: Annotated[str | None, Parameter(metavar="ENDPOINT")] = None,
    px4: Literal["auto", "1.16", "1.17", "1.18"] = "auto",
    only: Annotated[tuple[str, ...], Parameter(metavar="NAME", consume_multiple=True)] = (),
    list: bool = False,
    json: bool = False,
    wait: Seconds = 15.0,
    from_elsewhere: bool = False,
    i_have_removed_the_propellers: bool = False,
    key: Annotated[Path | None, Parameter(metavar="FILE")] = None,
) -> int:
    """Check fact by fact that a MAVLink endpoint behaves as measured on a real PX4 of its version.

    Most facts need a flight: the vehicle is armed and flown up to 10 m high, by its own position
    estimate and in any direction, but only if it is simulated. Parameters and rates are put back at
    the end.

    Args:
        endpoint: udpin://HOST:PORT or udpout://HOST:PORT
        gcs: also check the ground station's link (udpin://127.0.0.1:14550)
        sih: also check the link on which the simulator shows viewers the true state
            (udpin://127.0.0.1:19410)
        px4: version to judge by; auto: the version that the endpoint reports
        only: facts or topics; * and ? are wildcards
        list: say which facts would be checked, and end
        json: findings as JSON on stdout, progress on stderr
        wait: longest wait for the first message
        from_elsewhere: speak first from another port than ENDPOINT's, and check that the stream
            moves to that port; the vehicle is locked to it until it restarts
        i_have_removed_the_propellers: turn motors even if the vehicle does not look simulated
        key: sign with the key of MAVLink signing that the vehicle has, as keys/NAME.mavlink.key
    """
    facts = _facts(only, px4)
    if list:
        for fact in facts.values():
            print(f"{fact.name:38} {fact.says}: {fact.expected}")
        print(f"{len(facts)} facts")
        return EXIT_OK

    if endpoint is None:
        raise ConfigError(
            "which endpoint? For instance udpin://127.0.0.1:14540, PX4's first onboard link."
        )
    if not 0.0 <= wait <= _LONGEST_S:
        raise ConfigError(f"--wait is {wait:g}; give 0 to 600 s.")
    with contextlib.ExitStack() as stack:
        port = stack.enter_context(contextlib.closing(_open(endpoint)))
        ground = None
        if gcs:
            ground = stack.enter_context(contextlib.closing(_open(gcs)))
        simulator = None
        if sih:
            simulator = stack.enter_context(contextlib.closing(_open(sih)))

        own_key = None
        if key is not None:
            own_key = read_key(str(key), "FLEET")  # there is no fleet file to name in a refusal
        terms = Terms(i_have_removed_the_propellers, wait, from_elsewhere, own_key)
        report = FactReport(facts, is_version_known=px4 != "auto")
        return _check(endpoint, report, (port, ground, simulator), terms, is_json=json)


def _facts(patterns: tuple[str, ...], px4: str) -> dict[str, Fact]:
    """Return the facts to check by name, with their expectations for a version of PX4."""
    version = px4
    if px4 == "auto":
        version = VERSIONS[0]  # until the endpoint has reported its version
    try:
        return matching(facts_of(version, FACTS).values(), patterns)
    except KeyError as error:
        topics = ", ".join(sorted({fact.name.partition(".")[0] for fact in FACTS}))
        raise ConfigError(
            f"no fact is called {error.args[0]!r}. Topics: {topics}; all names: --list."
        ) from None


def _open(endpoint: str) -> UdpPort:
    """Open a port of this computer for an endpoint.

    Raises:
        ConfigError: the endpoint has a wrong form, or its port is in use.
    """
    match = _ENDPOINT.fullmatch(endpoint)
    if match is None or not 0 < int(match["port"]) < 65536:
        raise ConfigError(
            f"{endpoint!r} is no endpoint. Use udpin://127.0.0.1:14540 or udpout://127.0.0.1:18570."
        )

    host = match["host"] or "0.0.0.0"
    address = (host, int(match["port"]))
    try:
        if match["kind"] == "udpin":
            return UdpPort(address, None)
        return UdpPort(None, address)
    except OSError as error:
        raise ConfigError(
            f"UDP port {address[1]} on {host} cannot be bound ({error.strerror or error}). "
            "Does another client of this vehicle listen there? Stop it, then restart the vehicle: "
            "it stays with its first client."
        ) from None


def _check(
    endpoint: str,
    report: FactReport,
    ports: tuple[UdpPort, UdpPort | None, UdpPort | None],
    terms: Terms,
    *,
    is_json: bool,
) -> int:
    """Check facts, print each as soon as it is known, and return the exit status.

    Args:
        endpoint: the endpoint as the user wrote it.
        report: collects the results.
        ports: ports of the endpoint, of the ground station's link and of the simulator's link.
        terms: conditions of the check.
        is_json: whether JSON goes to standard output, and lines for people to standard error.
    """
    out = sys.stderr if is_json else sys.stdout

    def say(line: str) -> None:
        print(line, file=out, flush=True)

    report.show = lambda result: say(_line_of(result))
    say(f"{len(report.facts)} facts at {endpoint}; all of them take some five minutes and a flight")

    port, ground, simulator = ports
    try:
        client = check(port, ground, report, terms, lambda group: say(f"-- {group}"), simulator)
    except NobodyAnsweredError:
        say(
            f"covey check endpoint: nobody answered at {endpoint} within {terms.wait_s:g} s. Is the"
            " vehicle running, and did another client speak to it before?"
            " PX4 stays with its first client until it restarts."
        )
        return EXIT_NO_ANSWER
    except KeyboardInterrupt:
        say(
            "interrupted; the vehicle was put down and its parameters were put back, unless a line "
            "above names what was not"
        )
        return EXIT_INTERRUPTED

    counts = {verdict.value: report.count(verdict) for verdict in FactVerdict}
    if is_json:
        findings = {
            "schema": 1,
            "endpoint": endpoint,
            "system_id": client.system_id,
            "pace": round(client.clock.pace, 3),
            **counts,
            "facts": [result.as_json() for result in report.results.values()],
        }
        print(dumps(findings, indent=1))
    say(", ".join(f"{count} {word}" for word, count in counts.items()))

    differs = counts[FactVerdict.DIFFERS.value] > 0
    return EXIT_FAILED if differs else EXIT_OK


def _line_of(result: FactResult) -> str:
    """Return the line about one fact: verdict, measurement, and expectation."""
    fact = result.fact
    line = f"{_MARKS[result.verdict]} {fact.name:38} {result.measured}   expected {fact.expected}"
    if result.reason:
        line += f"   {result.reason}"
    return line
