"""Files are opened in one place, which limits their size, kind and depth.

Whoever opens a file by another way has a row here, with the reason.
"""

from __future__ import annotations

import ast
from collections.abc import Iterable, Iterator

from tests.architecture import form

THE_PLACE = "onboard/config/file_reading.py"

# calls that read a file, or make values of a text
READS = {"read_text", "read_bytes", "imread", "loadtxt", "genfromtxt", "fromfile", "memmap"}
PARSERS = {
    ("tomllib", "load"),
    ("tomllib", "loads"),
    ("tomlkit", "parse"),
    ("json", "load"),
    ("json", "loads"),
    ("np", "load"),
    ("ast", "parse"),
    ("pickle", "load"),
    ("pickle", "loads"),
}

ALLOWED = {
    # texts and tables that are part of this software
    "groundstation/alarms/alarm_table.py": "its own table",
    "groundstation/console/screens/dialogs.py": "its own texts",
    "groundstation/evidence/proofs.py": "its own table",
    "groundstation/report/report_page.py": "its own scripts and styles",
    "groundstation/scene/static_files.py": "its own scripts and styles",
    "groundstation/shows/gallery.py": "the examples",
    "groundstation/starter/law_files.py": "its own template",
    "onboard/config/toml_reading.py": "package_table: its own tables",
    "onboard/px4/own_failsafes.py": "its own table",
    "onboard/process/service.py": "its own templates, and units that it wrote",
    "sitl/conformance/facts.py": "its own tables",
    "sitl/faults/catalogue.py": "its own table",
    "sitl/mavlink/extra_dialect.py": "its own table",
    "sitl/mavlink/streams.py": "its own table",
    "sitl/px4/journal.py": "its own table",
    "sitl/px4/parameters.py": "its own table",
    "sitl/px4/versions.py": "its own table",
    # TOML that Covey has just written, or that load_fleet has read
    "groundstation/commands/identify.py": "changes that it has written",
    "groundstation/flights/demo_missions.py": "text of a fleet that was loaded",
    "groundstation/flights/flight_settings.py": "text of a fleet that was loaded",
    "groundstation/flights/identification_flight.py": "text of a fleet that was loaded",
    "groundstation/keys/secured_fleet.py": "text of a fleet that was loaded",
    "groundstation/network/fleet_copy.py": "text of a fleet that was loaded",
    "groundstation/shows/output.py": "text that it has written",
    "groundstation/starter/starter_files.py": "text that it has written",
    "groundstation/starter/fleet_edit.py": "text of a fleet that was loaded",
    "sitl/monte_carlo/campaign_settings.py": "text of a loaded fleet, and a value of an option",
    # files of the kernel and of Covey's own processes
    "groundstation/evidence/folder.py": "a drawing that it has written",
    "groundstation/evidence/provenance.py": "hashes of its own code and of files that were loaded",
    "groundstation/network/machine.py": "files of the kernel",
    "groundstation/network/network_interfaces.py": "files of the kernel",
    "groundstation/orders/forecast_process.py": "bytes of a child that it has started",
    "groundstation/processes/supervisor.py": "logs of its own children",
    "groundstation/shows/import_show.py": "files of the show that it has just written",
    "groundstation/web/page_server.py": "its own page",
    "onboard/bus/clock_sync.py": "a file of the kernel",
    "sitl/monte_carlo/plot.py": "a trace that the same command has written",
    # one message of a record, whose chunk has a limit; nesting and wrong numbers leave it out
    "groundstation/recording/reader.py": "messages of a record within its limits",
}


def _reads(nodes: Iterable[ast.AST]) -> Iterator[int]:
    """Yield the lines of calls that read files or make values of texts."""
    for node in nodes:
        if not isinstance(node, ast.Call):
            continue
        function = node.func
        if isinstance(function, ast.Name) and function.id == "open" and _opens_to_read(node, 1):
            yield node.lineno
        if not isinstance(function, ast.Attribute):
            continue
        module = function.value.id if isinstance(function.value, ast.Name) else ""
        if function.attr in READS or (module, function.attr) in PARSERS:
            yield node.lineno
        if function.attr == "open" and module != "os" and _opens_to_read(node, 0):
            yield node.lineno


def _opens_to_read(call: ast.Call, place_of_mode: int) -> bool:
    """Whether a call of open has no mode, or one that reads."""
    if len(call.args) <= place_of_mode:
        return place_of_mode == 1  # the built-in one; methods of that name open other things
    mode = call.args[place_of_mode]
    return isinstance(mode, ast.Constant) and isinstance(mode.value, str) and "r" in mode.value


def test_files_of_others_are_opened_in_one_place_only() -> None:
    found = [
        f"{module.path}:{line}"
        for module in form.modules()
        if module.path != THE_PLACE and module.path not in ALLOWED
        for line in _reads(module.nodes)
    ]
    assert not found, f"Open them with {THE_PLACE}, or give the reason here: {found}"


def test_each_exception_still_reads_something() -> None:
    reading = {module.path for module in form.modules() if any(_reads(module.nodes))}
    assert set(ALLOWED) <= reading
