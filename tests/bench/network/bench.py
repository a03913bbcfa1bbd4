"""``make bench-network``: ages of states over a bad link, links over long ways and through outages,
a fleet cut in two in flight, agents on a locked bus.

For the ages two processes in network namespaces of their own, one publishing its state at 50 Hz,
one looking at the newest one 50 times a second, as an agent does. Between them lies a link that
delays, and loses packets of every kind, TCP's included. The flights are in ``partition.py``, the
agents are those of ``make bench-agents``.
"""

from __future__ import annotations

import argparse
import datetime
import json
import math
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

from groundstation.keys.secured_fleet import secure_fleet
from groundstation.processes.free_ports import toml_text
from tests.bench import agents
from tests.bench.fixture import fleet_data
from tests.bench.network import links, partition
from tests.bench.network.bad_link import LinkQuality
from tests.bench.network.links import Opening, Outage
from tests.bench.peers.pages import insert

EXIT_OK = 0
EXIT_FAILED = 1
EXIT_WRONG_INPUT = 2
SCHEMES = ("quic", "udp", "tls", "tcp")
LINKS = {
    "no loss": (LinkQuality(), math.inf),
    "5 % independent": (LinkQuality(loss=0.05), 60.0),
    "5 % in bursts of 3": (LinkQuality(loss=0.05, burst=3.0), 130.0),
}
ROUND_TRIPS_S = (0.04, 0.3, 0.6)
OUTAGES_S = (0.3, 1.0, 3.0)
OUTAGE_TIMES = 3  # each; the longest age of all is told
LONGEST_COST_S = 1.3  # of an outage of 1 s
_ADDRESSES = ("10.77.0.1", "10.77.0.2")
_DATAGRAMS = ("quic", "udp")  # what the bounds are for


@dataclass(frozen=True, slots=True)
class Age:
    """Ages of the newest state, at each tick of the listener."""

    scheme: str
    link: str
    p50_ms: float
    p99_ms: float
    max_ms: float
    messages: int
    bound_ms: float | None  # of the 99th percentile; None where nothing is asked


def measure(scheme: str, link: str, seconds: float, folder: Path, seed: int = 1) -> Age:
    """Measure one transport over one link.

    Raises:
        OSError: this computer does not allow network namespaces.
        RuntimeError: nothing arrived.
    """
    path = _fleet_file(scheme, folder)
    quality, bound_ms = LINKS[link]
    carried = links.carry(path, _ADDRESSES, quality, seconds=seconds, seed=seed)
    ages_ms = sorted(carried.ages_ms)
    if not ages_ms:
        raise RuntimeError(f"Nothing arrived over {scheme}.")
    bound = bound_ms if scheme in _DATAGRAMS and bound_ms < math.inf else None

    def quantile_ms(share: float) -> float:
        return ages_ms[min(len(ages_ms) - 1, int(share * len(ages_ms)))]

    return Age(
        scheme=scheme,
        link=link,
        p50_ms=quantile_ms(0.5),
        p99_ms=quantile_ms(0.99),
        max_ms=quantile_ms(1.0),
        messages=carried.messages,
        bound_ms=bound,
    )


def _fleet_file(scheme: str, folder: Path) -> Path:
    """Write a fleet of two, with keys where the transport has some."""
    data = fleet_data(2, 3.0, "network")
    for vehicle, address in zip(data["vehicles"].values(), _ADDRESSES, strict=True):
        vehicle["agent"] = f"tcp/{address}:7460"
    own = folder / scheme
    own.mkdir(exist_ok=True)
    path = own / "fleet.toml"
    path.write_text(toml_text(data), encoding="utf-8")
    if scheme in ("quic", "tls"):
        secure_fleet(str(path), datetime.datetime.now(datetime.UTC))
        path.write_text(path.read_text().replace("quic/", f"{scheme}/"), encoding="utf-8")
    else:
        path.write_text(path.read_text().replace("tcp/", f"{scheme}/"), encoding="utf-8")
    return path


def table(ages: Sequence[Age]) -> str:
    """Return the rows of docs/network.md."""
    lines = [
        "| link, 20 ms each way | transport | p50 | p99 | longest | asked of p99 |",
        "|---|---|---|---|---|---|",
    ]
    for age in ages:
        asked = "" if age.bound_ms is None else f"at most {age.bound_ms:.0f} ms"
        figures = " | ".join(
            f"{value_ms:.0f} ms" for value_ms in (age.p50_ms, age.p99_ms, age.max_ms)
        )
        lines.append(f"| {age.link} | `{age.scheme}/` | {figures} | {asked} |")
    return "\n".join(lines)


def _bench_ages(options: argparse.Namespace) -> int:
    with tempfile.TemporaryDirectory(prefix="covey-network-") as scratch:
        schemes = options.transports.split(",")
        ages = [
            measure(one, link, options.seconds, Path(scratch)) for link in LINKS for one in schemes
        ]
    print(json.dumps([asdict(age) for age in ages]) if options.json else table(ages))
    insert(options.page, "ages", table(ages))
    return (
        EXIT_FAILED
        if any(age.bound_ms is not None and age.p99_ms > age.bound_ms for age in ages)
        else EXIT_OK
    )


def measure_links(schemes: Sequence[str], folder: Path) -> tuple[list[Opening], list[Outage]]:
    """Measure how long links take to open over long ways, and what outages cost.

    Raises:
        OSError: this computer does not allow network namespaces.
    """
    openings = []
    outages = []
    for scheme in schemes:
        path = _fleet_file(scheme, folder)
        for round_trip_s in ROUND_TRIPS_S:
            quality = LinkQuality(delay_s=0.5 * round_trip_s)
            carried = links.carry(path, _ADDRESSES, quality, seconds=1.0)
            openings.append(Opening(scheme, 1e3 * round_trip_s, carried.opened_s))
        for lasts_s in OUTAGES_S:
            ages_ms: list[float] = []
            for _ in range(OUTAGE_TIMES):
                carried = links.carry(
                    path, _ADDRESSES, LinkQuality(), seconds=lasts_s + 5.0, outage_s=lasts_s
                )
                ages_ms += carried.ages_ms
            outages.append(Outage(scheme, lasts_s, 1e-3 * max(ages_ms)))
    return openings, outages


def links_table(openings: Sequence[Opening], outages: Sequence[Outage]) -> str:
    """Return the rows of docs/network.md."""
    trips = [f"open over {1e3 * trip_s:.0f} ms" for trip_s in ROUND_TRIPS_S]
    costs = [f"outage of {lasts_s:g} s" for lasts_s in OUTAGES_S]
    columns = ["transport", *trips, *costs]
    lines = [f"| {' | '.join(columns)} |", "|---" * len(columns) + "|"]
    for scheme in dict.fromkeys(one.scheme for one in openings):
        cells = [f"`{scheme}/`"]
        for opening in openings:
            if opening.scheme == scheme:
                opened_s = opening.opened_s
                cells.append("never" if opened_s is None else f"after {opened_s:.1f} s")
        for outage in outages:
            if outage.scheme == scheme:
                cells.append(f"{outage.longest_age_s:.2f} s")
        lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines)


def _bench_links(options: argparse.Namespace) -> int:
    with tempfile.TemporaryDirectory(prefix="covey-links-") as scratch:
        openings, outages = measure_links(options.transports.split(","), Path(scratch))
    print(
        json.dumps([*map(asdict, openings), *map(asdict, outages)])
        if options.json
        else links_table(openings, outages)
    )
    insert(options.page, "links", links_table(openings, outages))
    is_right = all(one.opened_s is not None for one in openings) and all(
        one.longest_age_s <= LONGEST_COST_S for one in outages if one.lasts_s <= 1.0
    )
    return EXIT_OK if is_right else EXIT_FAILED


def _bench_partition(options: argparse.Namespace) -> int:
    flights = partition.fly_all(
        options.flights, options.cut_s, lambda line: print(line, file=sys.stderr)
    )
    print(
        json.dumps([asdict(flight) for flight in flights])
        if options.json
        else partition.table(flights)
    )
    insert(options.page, "partition", partition.table(flights))
    return EXIT_FAILED if any(flight.problems() for flight in flights) else EXIT_OK


def _bench_agents(options: argparse.Namespace) -> int:
    return agents.main(
        ["--keys", "--agents", str(options.agents), *(["--json"] if options.json else [])]
    )


PARTS = {
    "ages": _bench_ages,
    "links": _bench_links,
    "partition": _bench_partition,
    "agents": _bench_agents,
}


def main(argv: Sequence[str] | None = None) -> int:
    """Entry of ``make bench-network``; exit status 0 when everything is as asked."""
    parser = argparse.ArgumentParser(
        prog="make bench-network", description=__doc__.partition("\n")[0]
    )
    parser.add_argument(
        "--only", choices=PARTS, action="append", help="this part; may be given several times"
    )
    parser.add_argument(
        "--seconds", type=float, default=20.0, help="ages: measured time of each (default 20)"
    )
    parser.add_argument("--transports", default=",".join(SCHEMES), help="ages: of quic,udp,tls,tcp")
    parser.add_argument(
        "--flights", type=int, default=10, help="partition: how many, of a minute each (default 10)"
    )
    parser.add_argument(
        "--cut-s", type=float, default=10.0, help="partition: how long (default 10)"
    )
    parser.add_argument("--agents", type=int, default=10, help="agents: how many (default 10)")
    parser.add_argument(
        "--page", type=Path, default=Path(), help="page that gets the tables: docs/network.md"
    )
    parser.add_argument(
        "--json", action="store_true", help="figures as JSON on stdout, a line for each part"
    )
    options = parser.parse_args(argv)
    is_sound = (
        1.0 <= options.seconds <= 600.0
        and 1 <= options.flights <= 100
        and 1.0 <= options.cut_s <= 60.0
    )
    if not set(options.transports.split(",")) <= set(SCHEMES) or not is_sound:
        print(
            "bench network: give transports of quic,udp,tls,tcp, 1 to 600 seconds, 1 to 100 "
            "flights.",
            file=sys.stderr,
        )
        return EXIT_WRONG_INPUT
    try:
        return max(PARTS[part](options) for part in options.only or PARTS)
    except (OSError, RuntimeError) as error:
        print(f"bench network: {error}", file=sys.stderr)
        return EXIT_WRONG_INPUT


if __name__ == "__main__":
    sys.exit(main())
