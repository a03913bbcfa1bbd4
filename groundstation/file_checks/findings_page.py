"""The findings about one file, as a page for people."""

from __future__ import annotations

import shutil
import textwrap
from collections.abc import Collection

from groundstation.file_checks.examination import ExaminedFile
from onboard.feasibility.finding import Finding
from onboard.feasibility.fleet_checks import ErrorClass, error_class
from onboard.plain_text import numbered

_NARROWEST = 60
_WIDEST = 120
_MARKS = {"refused": "REFUSED", "warning": "warning", "note": "note", "ok": "ok"}
_MARK_WIDTH = 9  # including the space after it
_SENTENCE_WIDTH = 40  # at least; in narrower terminals a sentence stands below its name


def page(examined: ExaminedFile, errors: ErrorClass | None, shown: Collection[Finding] = ()) -> str:
    """Return the findings as a list, the worst first, and the verdict.

    Args:
        examined: the examined file.
        errors: accuracy of the position on the command line; None: as the fleet file declares.
        shown: findings on the pages before this one. They are only counted here, since a mission
            repeats all findings of its fleet.
    """
    new_findings = [finding for finding in examined.findings if finding not in shown]
    repeated = len(examined.findings) - len(new_findings)
    columns = shutil.get_terminal_size((_WIDEST, 24)).columns
    width = max(_NARROWEST, min(columns, _WIDEST))
    name_width = max((len(finding.title) for finding in new_findings), default=0)
    indent = " " * (_MARK_WIDTH + name_width + 2)

    is_below = width - len(indent) < _SENTENCE_WIDTH
    if is_below:
        indent = " " * _MARK_WIDTH

    lines = [examined.headline]
    for finding in new_findings:
        head = f"{_MARKS[finding.status]:<8} {finding.title:<{name_width}}  "
        if is_below:
            lines.append(head.rstrip())
            head = indent
        lines += textwrap.wrap(
            finding.sentence, width, initial_indent=head, subsequent_indent=indent
        )
    if repeated:
        lines.append(f"{numbered(repeated, 'finding')} about its fleet: see above.")
    lines.append(_verdict(examined, errors))
    return "\n".join(lines)


def _verdict(examined: ExaminedFile, errors: ErrorClass | None) -> str:
    refused = sum(1 for finding in examined.findings if finding.status == "refused")
    warnings = sum(1 for finding in examined.findings if finding.status == "warning")
    accuracy = f"with the accuracy of '{errors or error_class(examined.fleet)}'"

    if refused:
        return f"Do not fly this, {accuracy}: {numbered(refused, 'finding')} against it."
    if warnings:
        return f"This can be flown, {accuracy}, with {numbered(warnings, 'warning')}."
    return f"This can be flown, {accuracy}."
