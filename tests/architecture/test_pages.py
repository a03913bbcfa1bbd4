"""What the pages for new users tell people to type and to write works, in the order in which they
tell it.
"""

from __future__ import annotations

import ast
import re
import shlex
import tomllib
from collections.abc import Iterator
from pathlib import Path

import pytest
from cyclopts import App

from groundstation.cli import command_words, current_words, find_command, front_page, main
from groundstation.mission_files.loading import load_mission

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
PAGES = (
    "tutorial",
    "my-mocap-lab",
    "my-search",
    "my-ci",
    "mission-file",
    "python-api",
    "crazyswarm",
    "formations",
)
_BLOCK = re.compile(r"(?:<!-- (file|append): (\S+) -->\n)?```(\w*)\n(.*?)```", re.DOTALL)
_RUN = (["init"], ["check"])  # for real; of the others only the options are checked
_FLOWN = ("--lockstep", "plot")  # these too, where there is time


def blocks(page: Path) -> Iterator[tuple[str, str, str, str]]:
    """What to do with each block, its file, its language and its text."""
    yield from _BLOCK.findall(page.read_text(encoding="utf-8"))


def commands(text: str) -> list[list[str]]:
    """The lines that call covey."""
    return [shlex.split(line) for line in text.splitlines() if line.startswith("covey ")]


def parse(words: list[str]) -> None:
    """Check a command line, do not run it; raises CycloptsError, or SystemExit for an agent's."""
    if words[0] == "agent":
        from onboard.process import deploy

        assert words[1] == "deploy"
        deploy.parser().parse_args(words[2:])
    elif not words[0].startswith("-"):
        words = current_words(words)
        app: App = front_page(words)
        app.parse_args(words, exit_on_error=False, print_error=False)


@pytest.mark.parametrize("flies", [False, pytest.param(True, marks=pytest.mark.long)])
@pytest.mark.parametrize("page", PAGES)
def test_what_a_page_says_works_in_its_order(
    page: str, flies: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    written: list[Path] = []
    for action, name, language, text in blocks(DOCS / f"{page}.md"):
        if action:
            path = tmp_path / name
            path.parent.mkdir(exist_ok=True)
            before = path.read_text(encoding="utf-8") if action == "append" else ""
            path.write_text(f"{before}\n{text}" if before else text, encoding="utf-8")
            written.append(path)
        if language == "python":
            ast.parse(text)
        elif language == "toml":
            tomllib.loads(text)
            if "[[step]]" in text and not action:
                (tmp_path / "shown.toml").write_text(text, encoding="utf-8")
                load_mission(tmp_path / "shown.toml")
        for _, *words in commands(text) if language == "console" else ():
            parse(words)
            if command_words(words) in _RUN or (flies and set(words) & set(_FLOWN)):
                assert main(words) == 0, words
    for path in written:
        if path.suffix == ".py" and "async def mission" in path.read_text(encoding="utf-8"):
            assert main(["check", str(path)]) == 0, path


def test_every_command_line_of_the_readme_that_is_no_pattern_is_understood() -> None:
    lines = re.findall(r"`(covey [^`]+)`", (ROOT / "README.md").read_text(encoding="utf-8"))
    whole = [line for line in lines if not re.search(r"[\[|A-Z.]{2}", line)]
    assert whole
    for _, *words in map(shlex.split, whole):
        is_known = find_command(current_words(words)[0]) is not None
        assert is_known or words[0].startswith("-"), words


def test_nobody_is_told_to_install_a_name_that_no_index_has() -> None:
    for folder in (ROOT, DOCS, ROOT / "onboard", ROOT / "groundstation", ROOT / "sitl"):
        for path in folder.glob("*.md") if folder in (ROOT, DOCS) else folder.rglob("*.py"):
            told = re.search(
                r"pip install[^\n`]*?(?<![\w/.*-])covey(?![-\w/])", path.read_text(encoding="utf-8")
            )
            assert told is None, f"{path}: {told}"


def _finding_names(source: str) -> Iterator[str]:
    """The names of the findings that a module makes, without what a mission's step adds to them."""
    tree = ast.parse(source)
    constants = {
        ast.unparse(node.targets[0]): node.value
        for node in tree.body
        if isinstance(node, ast.Assign)
    }
    for node in ast.walk(tree):
        makers = ("Finding", "at_least", "at_most", "warning_of")
        if not isinstance(node, ast.Call) or ast.unparse(node.func) not in makers:
            continue
        values = {keyword.arg: keyword.value for keyword in node.keywords}
        name = values.get("name")
        if isinstance(name, ast.Name):
            name = constants.get(name.id)
        if isinstance(name, ast.JoinedStr):
            name = name.values[0]
        if isinstance(name, ast.Constant):
            yield str(name.value).removesuffix(", ")


def test_the_page_of_the_check_has_every_finding() -> None:
    _, _, table = (DOCS / "check.md").read_text(encoding="utf-8").partition("## The findings")
    cells = re.findall(r"^\| ([^|]*) \|", table, flags=re.MULTILINE)
    described = {name for cell in cells for name in cell.split(", ")}

    names: set[str] = set()
    for room in ("onboard/feasibility", "groundstation"):
        for path in (ROOT / room).rglob("*.py"):
            source = path.read_text(encoding="utf-8")
            if "feasibility.finding" in source:
                names.update(_finding_names(source))
    assert {"wind", "own law", "spacing", "path spacing"} <= names
    for name in names:
        assert any(row.startswith(name) for row in described), f"docs/check.md lacks '{name}'"


def _anchors(page: Path) -> set[str]:
    """The anchors of a page's headings, as GitHub makes them."""
    text = re.sub(r"```.*?```", "", page.read_text(encoding="utf-8"), flags=re.DOTALL)
    anchors: set[str] = set()
    for heading in re.findall(r"^#+ (.*)", text, flags=re.MULTILINE):
        words = re.sub(r"\]\([^)]*\)", "]", heading).lower()  # a link counts by its text
        anchors.add(re.sub(r"[^\w\- ]", "", words).strip().replace(" ", "-"))
    return anchors


def test_every_page_is_in_the_index_and_its_links_lead_somewhere() -> None:
    index = (DOCS / "index.md").read_text(encoding="utf-8")
    for page in DOCS.glob("*.md"):
        assert page.name == "index.md" or f"({page.name})" in index, (
            f"name {page.name} in docs/index.md"
        )
    for page in (*DOCS.glob("*.md"), *ROOT.glob("*.md")):
        text = page.read_text(encoding="utf-8")
        for target, anchor in re.findall(r"\]\(([^)#: ]*)(?:#([^) ]*))?\)", text):
            linked = page.parent / target if target else page
            assert linked.exists(), f"{page.name}: {target}"
            if anchor and linked.suffix == ".md":
                assert anchor in _anchors(linked), f"{page.name}: {target}#{anchor}"
