"""The preflight page: go or no-go of every vehicle, for ``covey check vehicles`` and the consoles.

Most checks are the agents' own; their reports come over the bus. The ground adds what no agent can
know: whether the vehicle and this ground have the same fleet file, whether there is a direct path
to PX4, whether all vehicles fly the same version of PX4, and whether this computer is fit.
"""

from __future__ import annotations

import os
import textwrap
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from typing import Any

from groundstation.client.client import FleetClient
from groundstation.fleet.fleet_files import has_other_file, unlisted_words
from groundstation.fleet.loop_lateness import WINDOW_S
from groundstation.fleet.state import FleetState, VehicleView
from onboard.bus.schema import Telemetry
from onboard.config.fleet import FleetConfig
from onboard.config.law import BUILT_IN
from onboard.exit_status import EXIT_FAILED, EXIT_NO_ANSWER, EXIT_OK
from onboard.plain_text import plain_line
from onboard.security.certificate_ends import end_of
from onboard.security.certificate_times import SOON_S, left_words, longest_required_validity_s
from onboard.security.credentials import files_of
from onboard.security.node_roles import NodeRole

_MARKS = {"ok": "ok", "advice": "advice", "no-go": "NO-GO"}
_WIDTH = 118

# Lateness of this ground from which the page advises, and from which it says no-go. At the second
# value, this ground would miss replies that agents have sent in time.
_LATE_ADVICE_S = 0.1
_LATE_NO_GO_S = 0.3


@dataclass(frozen=True, slots=True)
class PageLine:
    """One check of one vehicle, as on the page."""

    name: str
    is_ok: bool
    sentence: str
    remedy: str

    @property
    def status(self) -> str:
        """ok, advice or no-go."""
        if not self.is_ok:
            return "no-go"
        if self.remedy:
            return "advice"
        return "ok"


@dataclass(frozen=True, slots=True)
class VehiclePage:
    """All lines of one vehicle."""

    name: str
    answers: bool  # whether its agent is heard
    lines: tuple[PageLine, ...]

    @property
    def is_go(self) -> bool:
        """Whether nothing refuses take-off."""
        return self.answers and all(line.is_ok for line in self.lines)


def page_of(view: VehicleView, fleet: FleetConfig, now_ns: int) -> VehiclePage:
    """Return the page of one vehicle.

    Args:
        view: the vehicle as known now.
        fleet: the fleet file.
        now_ns: the ground's monotonic clock [ns].
    """
    telemetry = view.telemetry
    if telemetry is None or not view.is_fresh(now_ns):
        silent = PageLine(
            "agent", False, f"{view.name}'s agent does not answer.", "Start it: covey agent."
        )
        return VehiclePage(view.name, False, (silent,))

    if telemetry.disabled_by:
        line = PageLine(
            "service",
            True,
            f"{view.name} is disabled by {telemetry.disabled_by}: flights go on without it.",
            f"To fly it: covey order --fleet {fleet.path} enable {view.name}.",
        )
        return VehiclePage(view.name, True, (line,))

    lines = [
        *_place_lines(view.name, telemetry.stands_in_for),
        *_file_lines(view.name, telemetry, fleet),
        *_report_lines(view, telemetry, now_ns),
        _direct_path_line(view.name, fleet),
    ]
    return VehiclePage(view.name, True, tuple(lines))


def _place_lines(name: str, place: str) -> list[PageLine]:
    """Return a line about a vehicle that stands in for another one; otherwise none."""
    if not place:
        return []
    sentence = f"{name} stands in for {place}, with its spot, slots and paths."
    return [PageLine("place", True, sentence, "")]


def _file_lines(name: str, telemetry: Telemetry, fleet: FleetConfig) -> list[PageLine]:
    """Return a line if a vehicle flies with another fleet file or another law; otherwise none."""
    if has_other_file(telemetry, fleet):
        sentence = (
            f"{name} flies with another fleet file than {fleet.path} "
            f"({telemetry.config_hash}, here {fleet.config_hash})."
        )
        remedy = (
            "Give the vehicle's computer this file and restart its agent, "
            "or give this command the vehicle's file."
        )
        return [PageLine("ground's file", False, sentence, remedy)]

    if telemetry.law != fleet.law.name:
        sentence = (
            f"{name} flies the law '{telemetry.law}' instead of the file's '{fleet.law.name}'."
        )
        if telemetry.law not in BUILT_IN:
            sentence += " So this ground cannot compare their fleet files."
        remedy = "Restart its agent without --law to fly the file's."
        return [PageLine("ground's file", True, sentence, remedy)]

    return []


def _report_lines(view: VehicleView, telemetry: Telemetry, now_ns: int) -> list[PageLine]:
    """Return the agent's own checks, or a line about why there are none."""
    report = view.preflight
    if report is not None and view.has_preflight(now_ns) and report.boot_id == telemetry.boot_id:
        return [PageLine(*check) for check in report.checks]

    if telemetry.is_airborne or telemetry.is_armed:
        sentence = f"It is {telemetry.state}, where no preflight check is made."
        return [PageLine("report", False, sentence, "Wait until it has landed.")]
    return [
        PageLine(
            "report",
            False,
            "Its agent sends no report.",
            "Restart it with this version of Covey.",
        )
    ]


def _direct_path_line(name: str, fleet: FleetConfig) -> PageLine:
    """Return the line about the direct path, on which kill and land reach PX4 without the agent."""
    direct = fleet.vehicles[name].direct
    if direct is None:
        return PageLine(
            "direct path",
            True,
            "The fleet file gives no direct endpoint: kill and land end with the agent.",
            f"Set vehicles.{name}.direct to PX4's ground link.",
        )
    return PageLine("direct path", True, f"Kill and land can go straight to PX4 at {direct}.", "")


def pages_of(
    state: FleetState, fleet: FleetConfig, names: Sequence[str], now_ns: int
) -> tuple[VehiclePage, ...]:
    """Return the pages of several vehicles.

    Args:
        state: the fleet as known now.
        fleet: the fleet file.
        names: vehicles.
        now_ns: the ground's monotonic clock [ns].

    Returns:
        The page of each vehicle, with the lines that are the same for the whole fleet.
    """
    fleet_lines = [
        *_unlisted_lines(state, fleet, now_ns),
        *_version_lines(state, fleet, names),
        *_ground_key_lines(fleet),
        *_computer_lines(state),
    ]

    pages = []
    for name in names:
        page = page_of(state.vehicles[name], fleet, now_ns)
        if page.answers:
            page = replace(page, lines=(*page.lines, *fleet_lines))
        pages.append(page)
    return tuple(pages)


def _unlisted_lines(state: FleetState, fleet: FleetConfig, now_ns: int) -> list[PageLine]:
    """Return a line if vehicles fly that the fleet file lacks; otherwise none."""
    if not state.unlisted_up:
        return []
    return [PageLine("other vehicles", False, unlisted_words(state, fleet, now_ns), "")]


def _version_lines(state: FleetState, fleet: FleetConfig, names: Sequence[str]) -> list[PageLine]:
    """Return a line if the vehicles have reported different versions of PX4; otherwise none."""
    vehicles: dict[tuple[int, int], list[str]] = {}  # version -> vehicles
    for name in names:
        report = state.vehicles[name].preflight
        if report is not None and report.px4_version is not None:
            vehicles.setdefault(report.px4_version, []).append(name)
    if len(vehicles) < 2:
        return []

    versions = sorted(vehicles)
    listed = "; ".join(
        f"v{_dotted(version)}: {', '.join(vehicles[version])}" for version in versions
    )
    sentence = f"This fleet has {len(vehicles)} versions of PX4: {listed}."

    first = _dotted(versions[0])
    last = _dotted(versions[-1])
    remedy = (
        "Each is asked for the parameters of its own version. What else differs: "
        f"covey px4 compare {first} {last} --fleet {fleet.path}."
    )
    return [PageLine("versions", True, sentence, remedy)]


def _dotted(version: tuple[int, int]) -> str:
    major, minor = version
    return f"{major}.{minor}"


def _computer_lines(state: FleetState) -> list[PageLine]:
    """Return a line if this ground's computer is too busy; otherwise none."""
    late_s = state.loop_late_s
    if late_s < _LATE_ADVICE_S:
        return []

    load, _, _ = os.getloadavg()  # programs that want a processor, over the last minute
    sentence = (
        f"This computer is too busy: this ground came {late_s:.2f} s late in the last "
        f"{WINDOW_S:g} s, and {load:.1f} programs want its {os.cpu_count()} processors."
    )
    remedy = (
        "End other programs, simulate fewer vehicles here, or allow priorities: "
        "add to /etc/security/limits.conf: USER - nice -10."
    )
    return [PageLine("this computer", late_s < _LATE_NO_GO_S, sentence, remedy)]


def _ground_key_lines(fleet: FleetConfig) -> list[PageLine]:
    """Return a line if this ground's certificate ends soon; otherwise none."""
    certificate = files_of(NodeRole.GROUND).certificate
    end_s = _certificate_end_s(os.path.join(fleet.keys_folder, certificate))
    if not fleet.has_keys or end_s is None:
        return []

    left_s = end_s - time.time()
    required_s = longest_required_validity_s(fleet)
    if left_s >= SOON_S:
        return []

    sentence = f"The certificate of this ground ends in {left_words(left_s)}."
    if left_s <= 0.0:
        sentence = "The certificate of this ground has ended: it can begin no flight."
    elif left_s < required_s:
        sentence = (
            f"The certificate of this ground ends in {left_words(left_s)}; a flight and an hour "
            f"to spare take {left_words(required_s)}."
        )
    remedy = f"Renew it: covey keys renew {fleet.path}, and start this command anew."
    return [PageLine("ground's key", left_s >= required_s, sentence, remedy)]


@cache
def _certificate_end_s(path: str) -> float | None:
    """Return the end of the certificate with which this process has opened its links [s, Unix].

    The result is kept, because a later file does not change the links.
    """
    if not os.path.exists(path):
        return None
    return end_of(path)


def has_reported(state: FleetState, names: Sequence[str], now_ns: int) -> bool:
    """Whether each vehicle has sent a report, or flies and therefore sends none.

    Args:
        state: the fleet as known now.
        names: vehicles.
        now_ns: the ground's monotonic clock [ns].
    """
    for name in names:
        view = state.vehicles[name]
        is_flying = view.is_fresh(now_ns) and view.is_airborne
        if not view.has_preflight(now_ns) and not is_flying:
            return False
    return True


def advice_of(
    state: FleetState, names: Sequence[str], *, is_recording: bool = False
) -> dict[str, list[str]]:
    """Return the advice of the newest reports.

    A vehicle whose ground truth is known is simulated: it needs no kill switch, and the emulator
    has put it on its spot.

    Args:
        state: the fleet as known now.
        names: vehicles to look at.
        is_recording: whether this ground records. Reports from before the record began may still
            advise to record, so that advice is left out.

    Returns:
        Advice -> vehicles.
    """
    advice: dict[str, list[str]] = {}
    for name in names:
        view = state.vehicles[name]
        report = view.preflight
        if report is None:
            continue

        is_simulated = view.truth is not None
        skipped = {"kill switch": is_simulated, "frame": is_simulated, "record": is_recording}
        for check, is_ok, sentence, remedy in report.checks:
            if is_ok and remedy and not skipped.get(check):
                advice.setdefault(f"{sentence} {remedy}", []).append(name)

    for line in _computer_lines(state):
        advice[f"{line.sentence} {line.remedy}"] = list(names)
    return advice


def exit_status(pages: Sequence[VehiclePage]) -> int:
    """Return the exit status: 0 if all are go, 10 if no vehicle has answered, otherwise 1."""
    if not any(page.answers for page in pages):
        return EXIT_NO_ANSWER
    if not all(page.is_go for page in pages):
        return EXIT_FAILED
    return EXIT_OK


def as_text(pages: Sequence[VehiclePage]) -> str:
    """Return the pages for people."""
    width = max((len(line.name) for page in pages for line in page.lines), default=0)
    rows: list[str] = []

    for page in pages:
        rows.append(f"{page.name}: {'go' if page.is_go else 'NO-GO'}")
        for line in page.lines:
            first = f"  {_MARKS[line.status]:<7}{plain_line(line.name):<{width}}  "
            text = plain_line(f"{line.sentence} {line.remedy}")
            rows += textwrap.wrap(
                text, _WIDTH, initial_indent=first, subsequent_indent=" " * len(first)
            )

    no_go = []
    for page in pages:
        if not page.is_go:
            failed = [plain_line(line.name) for line in page.lines if not line.is_ok]
            no_go.append(f"{page.name} ({', '.join(failed)})")

    if no_go:
        rows.append(f"Do not fly: {'; '.join(no_go)}.")
    else:
        rows.append(f"Go: {', '.join(page.name for page in pages)}.")
    return "\n".join(rows)


def as_mapping(pages: Sequence[VehiclePage]) -> Mapping[str, Any]:
    """Return the pages for programs."""
    return {
        "is_go": bool(pages) and all(page.is_go for page in pages),
        "vehicles": {
            page.name: {
                "is_go": page.is_go,
                "answers": page.answers,
                "checks": [
                    {
                        "name": line.name,
                        "status": line.status,
                        "is_ok": line.is_ok,
                        "sentence": line.sentence,
                        "remedy": line.remedy,
                    }
                    for line in page.lines
                ],
            }
            for page in pages
        },
    }


async def ask(
    client: FleetClient, names: Sequence[str], timeout_s: float, until_go_s: float = 0.0
) -> tuple[VehiclePage, ...]:
    """Wait until every vehicle has reported, and then until all are go.

    Args:
        client: fleet client that has been started.
        names: vehicles.
        timeout_s: longest wait for the reports [s].
        until_go_s: longest wait after that until all are go [s].

    Returns:
        The pages of the vehicles.
    """

    def is_go(state: FleetState) -> bool:
        return exit_status(pages_of(state, client.fleet, names, client.now_ns())) == 0

    await client.wait_for(lambda state: has_reported(state, names, client.now_ns()), timeout_s)
    if until_go_s > 0.0:
        await client.wait_for(is_go, until_go_s)
    return pages_of(client.state, client.fleet, names, client.now_ns())
