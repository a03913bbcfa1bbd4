import hashlib
from pathlib import Path

import pytest

import groundstation.scene
from groundstation.scene.static_files import LICENCE_OF_UPLOT, SCRIPTS, STYLES, text_of

FOLDER = Path(groundstation.scene.__file__).parent
# of the files in the package uplot 1.6.32
UPLOT_SHA256 = {
    "LICENSE": "8f989229699b4fe2f1a0432d0e9edc338a8a911e250e2d1b01ecd770a5f5b1bd",
    "uPlot.iife.min.js": "19c8d4c6ad88929a79f4ae49d6f7161566dfd0ba3d15cc495e974f787eb78f1f",
    "uPlot.min.css": "df630c6a8d6f8eeaff264b50f73ce5b114f646ffd9a0bb74f049b0a00135fa04",
}
WAYS_TO_MARKUP = ("innerHTML", "outerHTML", "insertAdjacentHTML", "document.write", "eval(")


def test_uplot_is_the_file_that_its_package_has():
    found = {
        path.name: hashlib.sha256(path.read_bytes()).hexdigest()
        for path in (FOLDER / "uplot").iterdir()
    }

    assert found == UPLOT_SHA256
    assert "MIT License" in text_of(LICENCE_OF_UPLOT)


def test_each_file_of_the_folder_is_named_and_can_be_read():
    named = {*SCRIPTS, *STYLES}
    present = {
        str(path.relative_to(FOLDER))
        for pattern in ("**/*.js", "**/*.css")
        for path in FOLDER.glob(pattern)
    }

    assert named == present
    assert all(text_of(name) for name in named)


@pytest.mark.parametrize("name", [name for name in SCRIPTS if not name.startswith("uplot/")])
def test_no_script_of_ours_makes_elements_from_markup(name):
    text = text_of(name)

    assert not [way for way in WAYS_TO_MARKUP if way in text]
