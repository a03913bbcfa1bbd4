"""The command ``covey sitl-check``: where to look, which facts, in lines or as JSON."""

from __future__ import annotations

import argparse
import json
import re
import sys
from collections.abc import Sequence

from sitl.conformance.endpoint import UdpPort
from sitl.conformance.facts import Fact, Finding, Report, Verdict, chosen
from sitl.conformance.suite import FACTS, NobodyAnsweredError, Terms, check

EXIT_OK, EXIT_DIFFERS, EXIT_WRONG_INPUT, EXIT_NOBODY, EXIT_INTERRUPTED = 0, 1, 2, 10, 130
_ENDPOINT = re.compile(r"(udpin|udpout)://([^:/]*):(\d{1,5})")
_MARKS = {Verdict.AGREES: "  agrees ", Verdict.DIFFERS: "X DIFFERS", Verdict.SKIPPED: "- skipped"}
_DESCRIPTION = (
    "Check fact by fact whether a MAVLink endpoint behaves as a real PX4 v1.16 was measured to. Most facts need a "
    "flight: the vehicle is armed and flown up to 10 m high, by its own position estimate and in any direction, but "
    "only if it is simulated. Parameters and rates are put back at the end."
)
_EPILOG = (
    "Exit status: 0 all agree; 1 some differ; 2 wrong input; 10 nobody answered; 130 interrupted. Boot facts need a "
    "vehicle that is started while the check already waits."
)


class WrongInputError(ValueError):
    """A sentence for people."""


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command; the exit status."""
    options = _parser().parse_args(argv)
    try:
        wanted = _wanted(options.only)
        if options.list:
            return _list(wanted)
        if options.endpoint is None:
            raise WrongInputError("which endpoint? For instance udpin://127.0.0.1:14540, PX4's first onboard link.")
        port = _open(options.endpoint)
        try:
            ground = _open(options.gcs) if options.gcs else None
        except WrongInputError:
            port.close()
            raise
    except WrongInputError as error:
        print(f"covey sitl-check: {error}", file=sys.stderr)
        return EXIT_WRONG_INPUT
    try:
        return _check(options, wanted, port, ground)
    finally:
        for each in (port, ground):
            if each is not None:
                each.close()


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="covey sitl-check", description=_DESCRIPTION, epilog=_EPILOG)
    parser.add_argument("endpoint", nargs="?", metavar="ENDPOINT", help="udpin://HOST:PORT or udpout://HOST:PORT")
    parser.add_argument(
        "--gcs", metavar="ENDPOINT", help="also check the ground station's link (udpin://127.0.0.1:14550)"
    )
    parser.add_argument("--only", nargs="+", default=[], metavar="NAME", help="facts or topics, also with * and ?")
    parser.add_argument("--list", action="store_true", help="say what would be checked, and end")
    parser.add_argument("--json", action="store_true", help="findings as JSON on stdout, progress on stderr")
    parser.add_argument("--wait", type=float, default=15.0, metavar="S", help="for the first message (default 15)")
    parser.add_argument(
        "--from-elsewhere",
        action="store_true",
        help="speak first from another port than ENDPOINT's, to see the stream move there; "
        "the vehicle is locked to that port until it restarts",
    )
    parser.add_argument(
        "--i-have-removed-the-propellers",
        action="store_true",
        dest="may_turn_motors",
        help="turn motors even if the vehicle does not look simulated",
    )
    return parser


def _wanted(patterns: list[str]) -> dict[str, Fact]:
    try:
        return chosen(FACTS, patterns)
    except KeyError as error:
        topics = ", ".join(sorted({fact.name.partition(".")[0] for fact in FACTS}))
        raise WrongInputError(f"no fact is called {error.args[0]!r}. Topics: {topics}; all names: --list.") from None


def _open(endpoint: str) -> UdpPort:
    match = _ENDPOINT.fullmatch(endpoint)
    if match is None or not 0 < int(match[3]) < 65536:
        raise WrongInputError(f"{endpoint!r} is no endpoint. Use udpin://127.0.0.1:14540 or udpout://127.0.0.1:18570.")
    address = (match[2] or "0.0.0.0", int(match[3]))
    try:
        return UdpPort(address, None) if match[1] == "udpin" else UdpPort(None, address)
    except OSError as error:
        raise WrongInputError(
            f"UDP port {address[1]} on {address[0]} cannot be bound ({error.strerror or error}). "
            "Does another client of this vehicle listen there? Stop it, then restart the vehicle: it stays with its "
            "first client."
        ) from None


def _list(wanted: dict[str, Fact]) -> int:
    for fact in wanted.values():
        print(f"{fact.name:38} {fact.says}: {fact.expected}")
    print(f"{len(wanted)} facts")
    return EXIT_OK


def _check(options: argparse.Namespace, wanted: dict[str, Fact], port: UdpPort, ground: UdpPort | None) -> int:
    out = sys.stderr if options.json else sys.stdout

    def say(line: str) -> None:
        print(line, file=out, flush=True)

    def tell(finding: Finding) -> None:
        reason = f"   {finding.reason}" if finding.reason else ""
        expected = finding.fact.expected
        say(f"{_MARKS[finding.verdict]} {finding.fact.name:38} {finding.measured}   expected {expected}{reason}")

    report = Report(wanted, tell)
    terms = Terms(options.may_turn_motors, options.wait, options.from_elsewhere)
    say(f"{len(wanted)} facts at {options.endpoint}; all of them take some five minutes and a flight")
    try:
        pilot = check(port, ground, report, terms, lambda phase: say(f"-- {phase}"))
    except NobodyAnsweredError:
        say(
            f"covey sitl-check: nobody answered at {options.endpoint} within {options.wait:g} s. Is the vehicle "
            "running, and did another client speak to it before? PX4 stays with its first client until it restarts."
        )
        return EXIT_NOBODY
    except KeyboardInterrupt:
        say("interrupted; the vehicle was put down and its parameters were put back")
        return EXIT_INTERRUPTED
    counts = {verdict.value: report.count(verdict) for verdict in Verdict}
    if options.json:
        findings = [finding.as_json() for finding in report.findings.values()]
        about = {"endpoint": options.endpoint, "system_id": pilot.system_id, "pace": round(pilot.clock.pace, 3)}
        print(json.dumps({"schema": 1, **about, **counts, "facts": findings}, indent=1))
    say(", ".join(f"{count} {word}" for word, count in counts.items()))
    return EXIT_DIFFERS if counts[Verdict.DIFFERS.value] else EXIT_OK


if __name__ == "__main__":
    sys.exit(main())
