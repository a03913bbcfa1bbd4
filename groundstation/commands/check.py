"""``covey check``: checks fleet and mission files, and leads to the checks of everything else.

Examples:
  covey check configs/fleets/paper.toml
  covey check mission.toml --fleet fleet.toml --errors gps --json
  covey check fleet.toml --run-law
  covey check vehicles --fleet fleet.toml
  covey check computer fleet.toml --network
  covey check attack fleet.toml
  covey check endpoint udpin://127.0.0.1:14540

Exit status of a check of files: 0 all can be flown (warnings may remain); 1 a
finding refuses the flight; 2 a file is wrong. docs/check.md explains each
finding.
"""

from __future__ import annotations

import sys
from contextlib import redirect_stdout
from json import dumps
from typing import Annotated, Any

from cyclopts import Parameter

from groundstation.commands.mission_faults import refuse_wrong_fault_steps
from groundstation.commands.parameters import File, FileName
from groundstation.file_checks.examination import examine
from groundstation.file_checks.findings_page import page
from onboard.config.fleet import ConfigError
from onboard.exit_status import EXIT_FAILED, EXIT_OK, EXIT_WRONG_INPUT
from onboard.feasibility.finding import Finding
from onboard.feasibility.fleet_checks import ErrorClass
from onboard.plain_text import fitted

_QUESTIONS = """\
What do you want to know?

  covey check FLEET|MISSION...       are these files right, can they be flown?
  covey check vehicles --fleet FILE  may every vehicle take off now?
  covey check computer [FLEET]       is this computer fit? --network: the links
  covey check attack FLEET           who gets into the fleet's bus?
  covey check endpoint ENDPOINT      does it behave as a real PX4?
  covey px4 params --fleet FILE      has every PX4 the parameters it needs?
  covey px4 compare OLD NEW ...      what does another version of PX4 change?
  covey keys list FLEET              are the keys of the bus good, until when?
  covey mocap --fleet FILE --check   has each vehicle its own body and axes?

Each of them says more with --help."""


def check(
    *files: Annotated[FileName, Parameter(name="FLEET|MISSION")],
    fleet: File | None = None,
    json: bool = False,
    errors: Annotated[ErrorClass | None, Parameter(choices=ErrorClass)] = None,
    run_law: bool = False,
) -> int:
    """Say what is wrong with fleet or mission files, and whether they can be flown as configured.

    Without a file it says which command answers which question.

    Args:
        files: fleet or mission files
        fleet: check missions against this fleet
        json: a list with one object for each finding
        errors: accuracy of the position (default: as the fleet file declares it)
        run_law: import the fleet's own law, whose code then runs here with your rights; by default
            the law's file is only hashed
    """
    if not files:
        print(_QUESTIONS)
        return EXIT_WRONG_INPUT

    status = EXIT_OK
    rows: list[dict[str, Any]] = []
    # findings already printed; a later page with the same findings only counts them
    shown: list[Finding] = []
    for path in files:
        try:
            with redirect_stdout(sys.stderr):  # where the fleet's own law may print
                examined = examine(path, fleet, errors, runs_law=run_law)
            if examined.mission is not None:
                refuse_wrong_fault_steps(examined.mission)
        except ConfigError as error:
            status = EXIT_WRONG_INPUT
            rows.append(_row_of_wrong_file(path, error))
            print(fitted(f"covey: {error}", sys.stderr), file=sys.stderr)
            continue

        if any(finding.status == "refused" for finding in examined.findings):
            status = max(status, EXIT_FAILED)
        rows += [_row(path, finding) for finding in examined.findings]
        if not json:
            print(page(examined, errors, shown))
            shown += examined.findings

    if json:
        print(dumps(rows, indent=2))
    return status


def _row(path: str, finding: Finding) -> dict[str, Any]:
    """Return the object of a finding about a file."""
    return {
        "file": path,
        "name": finding.title,
        "status": finding.status,
        "value": finding.value,
        "bound": finding.bound,
        "unit": finding.unit,
        "relation": finding.relation,
        "sentence": finding.sentence,
        "remedy": finding.remedy,
    }


def _row_of_wrong_file(path: str, error: ConfigError) -> dict[str, Any]:
    """Return the object of an error in a file, with the keys of a finding's."""
    return {
        "file": path,
        "name": "file",
        "status": "wrong",
        "value": None,
        "bound": None,
        "unit": None,
        "relation": None,
        "sentence": str(error),
        "remedy": None,
    }
