"""``python -m onboard --fleet FILE --vehicle NAME``: one vehicle's agent."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence

from onboard.agent.loop import run_agent
from onboard.config.fleet import ConfigError, load_fleet
from onboard.exit_status import EXIT_WRONG_INPUT
from onboard.process import deploy, service


def command_line() -> argparse.ArgumentParser:
    """Return the parser of an agent's command line."""
    parser = argparse.ArgumentParser(
        prog="covey agent",
        description="Fly one vehicle of a fleet.",
        epilog="As a service of systemd: covey agent install, status or logs, "
        "with --fleet, --vehicle and --help. "
        "Onto all companions: covey agent deploy --help.",
    )
    parser.add_argument("--fleet", required=True, metavar="FILE", help="fleet file")
    parser.add_argument(
        "--vehicle", required=True, metavar="NAME", help="vehicle of the fleet file"
    )
    parser.add_argument("--law", metavar="NAME", help="avoidance law instead of the fleet file's")
    parser.add_argument(
        "--apply-params",
        action="store_true",
        help="set PX4's required parameters instead of only checking them",
    )
    parser.add_argument(
        "--mocap",
        choices=["bus"],
        help="listen to poses on the bus, whatever mocap.direct says: for emulated vehicles",
    )
    parser.add_argument(
        "--realtime",
        action="store_true",
        help="let the control loop take precedence over other processes, if allowed",
    )
    return parser


def main(argv: Sequence[str] | None = None) -> int:
    """Run an agent, or manage its service; return the exit status, 2 when the input is wrong."""
    if argv is None:
        argv = sys.argv[1:]
    words = list(argv)
    if words and words[0] in service.VERBS:
        return service.main(words)
    if words and words[0] == "deploy":
        return deploy.main(words[1:])

    arguments = command_line().parse_args(words)
    try:
        fleet = load_fleet(arguments.fleet).with_law(arguments.law)
        fleet.import_law()
        names = fleet.select(arguments.vehicle)
    except ConfigError as error:
        print(f"agent: {error}", file=sys.stderr)
        return EXIT_WRONG_INPUT

    if len(names) != 1:  # --vehicle may name a group
        print(f"agent: --vehicle {arguments.vehicle} must name one vehicle.", file=sys.stderr)
        return EXIT_WRONG_INPUT

    return run_agent(
        fleet,
        names[0],
        apply_params=arguments.apply_params,
        is_realtime=arguments.realtime,
        has_bus_mocap=arguments.mocap == "bus",
    )


if __name__ == "__main__":
    sys.exit(main())
