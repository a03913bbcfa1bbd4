"""The evidence as one HTML page that opens offline and can be printed. Pure.

The page has no script. It consists of escaped text and one picture.
"""

from __future__ import annotations

import base64
import html
from collections.abc import Iterable, Sequence

from groundstation.evidence.evidence_comparison import Agreement
from groundstation.evidence.evidence_summary import Evidence, share_beyond
from groundstation.evidence.matrix import NOT_SHOWN, SHOWN, WRONG, FailsafeRow, MatrixRow
from groundstation.evidence.volumes import GUST_OF_MEAN
from onboard.plain_text import numbered

PAGE_NAME = "evidence.html"
_MAX_REASONS = 8  # reasons of a row that are shown
_SHORT_HASH = 16  # letters of a digest that are shown
# a row with a larger upper bound of the share of wrong flights rests on too few flights
_WIDE_BOUND = 0.2

_WORDS = {SHOWN: "evidence for", WRONG: "against it", NOT_SHOWN: "not shown"}
_STYLE = """\
body { font: 15px/1.45 system-ui, sans-serif; max-width: 1100px; margin: 2em auto; padding: 0 1em;
  color: #1c2126; background: white; }
h1 { font-size: 1.5em; } h2 { font-size: 1.15em; margin-top: 2em; }
table { border-collapse: collapse; width: 100%; font-size: 13px; }
th, td { border-bottom: 1px solid #d5dade; padding: .45em .6em; text-align: left;
  vertical-align: top; }
th { background: #f1f3f5; }
tr.wrong td:first-child { border-left: 6px solid #b00020; background: #fdecee; }
tr.shown td:first-child { border-left: 6px solid #1a7f4b; }
tr.shown.wide td:first-child { border-left: 6px solid #c77700; }
tr.not-shown td:first-child { border-left: 6px solid #8a939c; color: #5a646d; }
.wrong-words { color: #b00020; font-weight: 600; }
code { font: 12px ui-monospace, monospace; overflow-wrap: anywhere; }
details { margin: .2em 0; } summary { cursor: pointer; }
img { max-width: 100%; border: 1px solid #d5dade; }
.note { background: #f6f7f8; border-left: 4px solid #5a646d; padding: .6em 1em; }
@media print { details::details-content { content-visibility: visible; display: block; }
  body { margin: 0; max-width: none; } }
"""
_POLICY = "default-src 'none'; img-src data:; style-src 'unsafe-inline'"


def page(evidence: Evidence, picture: bytes, agreements: Sequence[Agreement], other: str) -> str:
    """Return the page.

    Args:
        evidence: the evidence.
        picture: a PNG of the volumes.
        agreements: figures compared with another machine's; empty if there is no other one.
        other: the other machine in words.
    """
    title = f"{evidence.fleet}, {evidence.mission}, {evidence.wind_m_s:g} m/s of wind"
    parts = [
        "<!doctype html><html lang='en'><head><meta charset='utf-8'>",
        f'<meta http-equiv="Content-Security-Policy" content="{_POLICY}">',
        f"<title>Evidence: {_text(title)}</title><style>{_STYLE}</style></head><body>",
        f"<h1>Evidence for {_text(title)}</h1>",
        _introduction(evidence),
        "<h2>Volumes</h2>",
        _volumes(evidence, picture),
        "<h2>What was asked, and what was flown</h2>",
        _matrix(evidence),
        "<h2>By what this was made</h2>",
        _provenance(evidence),
    ]
    if agreements:
        parts += ["<h2>Beside another machine</h2>", _agreements_table(agreements, other)]
    parts.append("</body></html>\n")
    return "\n".join(parts)


def _introduction(evidence: Evidence) -> str:
    counts = dict.fromkeys(_WORDS, 0)
    for row in evidence.matrix:
        counts[row.status] += 1
    wide = sum(_is_wide(row) for row in evidence.matrix)
    wide_note = ""
    if wide:
        wide_note = (
            f"<p class='note'>{numbered(evidence.rounds, 'round')} of all faults: of the rows with"
            f" evidence, {wide} rest on so few flights that"
            f" {100.0 * _WIDE_BOUND:g} % of such flights or more may still be wrong. They say how"
            " many flights they rest on, and are marked in amber.</p>"
        )
    return (
        f"<p>{evidence.flights} flights of {len(evidence.vehicles)} vehicles in simulated time,"
        f" {evidence.wrong_flights} of them judged wrong. Of {len(evidence.matrix)} questions,"
        f" {counts[SHOWN]} have evidence for them, {counts[WRONG]} have something against them,"
        f" {counts[NOT_SHOWN]} are not shown.</p>"
        "<p class='note'>This is evidence from simulation, for the fleet file, the mission and the"
        " faults named here. It is no statement that an operation meets a regulation: that is the"
        " authority's to judge, together with everything in the last rows of the table, which no"
        " simulation shows.</p>"
        f"{wide_note}<p>To make it again: <code>{_text(evidence.command)}</code><br>"
        f"Digest of all flights: <code>{evidence.digest}</code></p>"
    )


def _volumes(evidence: Evidence, picture: bytes) -> str:
    volumes = evidence.volumes
    wind_with_gusts_m_s = GUST_OF_MEAN * volumes.wind_m_s
    rows = [
        (
            "Flight geography",
            f"{volumes.geography_above_ground_m:.1f} m high",
            "around what the mission plans and what was flown in this wind while nothing failed",
        ),
        (
            "Contingency volume",
            f"{volumes.excursion_m:.1f} m wider, {volumes.contingency_above_ground_m:.1f} m high",
            "the farthest and the highest that any vehicle came in all flights",
        ),
        (
            "Ground risk buffer",
            f"{volumes.fall_reach_m:.1f} m wider",
            f"a fall of {volumes.fall_s:.1f} s from {volumes.contingency_above_ground_m:.1f} m,"
            f" with {volumes.fastest_m_s:.1f} m/s over the ground and {wind_with_gusts_m_s:.1f} m/s"
            " of wind with gusts;"
            f" by the rule of one to one it would be {volumes.contingency_above_ground_m:.1f} m",
        ),
    ]
    cells = "".join(
        f"<tr><td>{_text(name)}</td><td>{_text(size)}</td><td>{_text(basis)}</td></tr>"
        for name, size, basis in rows
    )

    largest_share = share_beyond(evidence.flights)
    encoded = base64.b64encode(picture).decode("ascii")
    return (
        f"<img alt='the three volumes from above' src='data:image/png;base64,{encoded}'>"
        f"<table><tr><th>volume</th><th>size</th><th>from</th></tr>{cells}</table>"
        "<p>Their corners are in <code>geography.geojson</code>. The contingency volume is drawn"
        f" around these {evidence.flights} flights; of further flights drawn like them fewer than"
        f" {100.0 * largest_share:.2g} % go beyond it, with"
        " 95 % confidence.</p>"
    )


def _matrix(evidence: Evidence) -> str:
    head = (
        "<tr><th>question</th><th>asked by</th><th>result</th><th>flights</th>"
        "<th>wrong: exact bound (95 %)</th><th>shown by</th><th>remains open</th></tr>"
    )
    rows = [_matrix_row(row) for row in evidence.matrix]
    rows += [
        f"<tr class='not-shown'><td>{_text(topic)}</td><td></td><td>not shown</td><td></td>"
        f"<td></td><td></td><td>{_text(reason)}</td></tr>"
        for topic, reason in evidence.not_shown
    ]
    never = ", ".join(evidence.never_seen) or "none"
    return (
        f"<table>{head}{''.join(rows)}</table>"
        f"<p>Conditions of the failsafe table that no flight has brought about: {_text(never)}."
        " What shows these are the tests of Covey named in the rows.</p>"
    )


def _matrix_row(row: MatrixRow) -> str:
    status = row.status.replace(" ", "-")
    if _is_wide(row):
        status += " wide"
    bound = "-"
    if row.flights:
        bound = (
            f"{row.wrong_flights} of {row.flights}: below {100.0 * row.upper_bound:.2g} %"
            f" (interval {100.0 * row.low:.2g} to {100.0 * row.high:.2g} %)"
        )

    nearest = ""
    if row.smallest_m is not None:
        nearest = f"<br>nearest two {row.smallest_m:.2f} m"
    flights = "none" + pair_words(row)
    if row.flights:
        first_seed, last_seed = row.seeds
        flights = (
            f"{row.flights}, seeds {first_seed} to {last_seed}{nearest}"
            f"<br><code>{row.digest[:_SHORT_HASH]}</code>"
        )

    return (
        f"<tr class='{status}'><td>{_text(row.question)}</td>"
        f"<td>{'<br>'.join(map(_text, row.asked_by))}</td>"
        f"<td>{_text(result_words(row))}{_reasons(row.reasons)}</td><td>{flights}</td>"
        f"<td>{bound}</td><td>{_shown_by(row)}</td><td>{_text(row.remains)}</td></tr>"
    )


def _is_wide(row: MatrixRow) -> bool:
    """Return whether a row has evidence, but from so few flights that its bound is wide."""
    return row.status == SHOWN and row.upper_bound > _WIDE_BOUND


def result_words(row: MatrixRow) -> str:
    """Return what the flights of a row have shown, in words."""
    words = _WORDS[row.status]
    if row.status == SHOWN and row.not_flown:
        words += f", in part: {_not_flown_words(row)}"
    if _is_wide(row):
        words += f"; {numbered(row.flights, 'flight')} only"
    return words


def pair_words(row: MatrixRow) -> str:
    """Return what the flights of a row must have had, in words; empty for most rows."""
    if row.needs_pair:
        return " with two vehicles in the air"
    return ""


def _not_flown_words(row: MatrixRow) -> str:
    return f"{numbered(len(row.not_flown), 'fault')} not flown{pair_words(row)}"


def _reasons(reasons: Sequence[str]) -> str:
    if not reasons:
        return ""
    shown = "".join(f"<li>{_text(reason)}</li>" for reason in reasons[:_MAX_REASONS])
    rest = ""
    if len(reasons) > _MAX_REASONS:
        rest = f"<li>and {len(reasons) - _MAX_REASONS} more, in evidence.json</li>"
    return f"<ul class='wrong-words'>{shown}{rest}</ul>"


def _shown_by(row: MatrixRow) -> str:
    parts = []
    if row.faults:
        names = ", ".join(f"{name} ({count})" for name, count in row.faults.items())
        parts.append(_folded(numbered(len(row.faults), "fault"), _text(names)))
    if row.not_flown:
        parts.append(_folded(_not_flown_words(row), _text(", ".join(row.not_flown))))
    if row.rows:
        items = "".join(_failsafe_row(failsafe_row) for failsafe_row in row.rows)
        title = f"{numbered(len(row.rows), 'row')} of the failsafe table"
        parts.append(_folded(title, f"<ul>{items}</ul>"))
    return "".join(parts)


def _folded(title: str, content: str) -> str:
    return f"<details><summary>{title}</summary>{content}</details>"


def _failsafe_row(row: FailsafeRow) -> str:
    tests = "".join(f"<br><code>{_text(test)}</code>" for test in row.tests)
    wrong = ""
    if row.wrong:
        wrong = f" <span class='wrong-words'>{_text(row.wrong)}</span>"
    return (
        f"<li>{_text(row.condition)}: {_text(row.action)}, noticed in {row.flights_noticed} flights"
        f"{wrong}{tests}</li>"
    )


def _provenance(evidence: Evidence) -> str:
    made_by = evidence.provenance
    rows = [
        *made_by.versions.items(),
        *made_by.machine.items(),
        ("Covey's files, SHA-256", made_by.source),
        ("values of the fleet file", made_by.config_hash),
        *((f"{name}, SHA-256", value) for name, value in made_by.files.items()),
        *((f"certificate {name}, SHA-256", value) for name, value in made_by.certificates.items()),
    ]
    if not made_by.has_keys:
        rows.append(("certificates", "none: the bus of this fleet file is open"))
    elif not made_by.certificates:
        rows.append(("certificates", "the bus of this fleet file is locked; none is read here"))
    return f"<table>{''.join(_name_and_value(rows))}</table>"


def _name_and_value(rows: Iterable[tuple[str, str]]) -> Iterable[str]:
    for name, value in rows:
        yield f"<tr><td>{_text(name)}</td><td><code>{_text(value)}</code></td></tr>"


def _agreements_table(agreements: Sequence[Agreement], other: str) -> str:
    cells = []
    for agreement in agreements:
        status = "shown" if agreement.is_within else "wrong"
        cells.append(
            f"<tr class='{status}'><td>{_text(agreement.figure)}</td>"
            f"<td>{_text(agreement.here)}</td><td>{_text(agreement.there)}</td>"
            f"<td>{_text(agreement.result)}</td></tr>"
        )
    return (
        f"<p>The other machine: {_text(other)}.</p>"
        "<p>Compared are the wrong flights of each row, whose share has to lie in the other's exact"
        " interval, both ways, and the flights that leave the other's contingency volume, by width"
        " or height, of which there may be no more than that volume leaves out by chance.</p>"
        "<table><tr><th>figure</th><th>here</th><th>there</th><th>within what the other allows"
        f"</th></tr>{''.join(cells)}</table>"
    )


def _text(value: str) -> str:
    return html.escape(str(value))
