"""A law of somebody's own: found by its name in a fleet file, and told apart by its source.

The protocol is in docs/own-law.md. This code runs with the rights of whoever loads the fleet file.
"""

from __future__ import annotations

import hashlib
import importlib
import importlib.util
import inspect
import os
import sys
from collections.abc import Callable, Sequence
from importlib.metadata import entry_points
from types import ModuleType
from typing import Any

import msgspec

from onboard.config.law import BUILT_IN
from onboard.config.toml_reading import ConfigError

GROUP = "covey.laws"  # of entry points

# (file, hash of its source) -> what was made of it, once in a process
_modules: dict[tuple[str, str], ModuleType] = {}


class OwnLaw(msgspec.Struct, frozen=True):
    """A law that a fleet file names."""

    name: str  # as the fleet file has it
    source: str  # file of its module
    source_hash: str  # of that file, or of all of its package
    function: Callable[[Any, Any], Any]  # law(memory, inputs)


def load_own_law(name: str, folders: Sequence[str], path: str) -> OwnLaw:
    """Import a law.

    Args:
        name: ``module:function``, or an entry point of the group ``covey.laws``.
        folders: where the module is looked for before the installed ones.
        path: of the fleet file, for the sentences.
    Returns:
        the law.
    Raises:
        ConfigError: there is none of that name, its module cannot be imported, or it cannot be
            called as a law.
    """
    where = f"{path}: 'law.name' is {name!r}"
    module_name, _, function_name = _target(name, where).partition(":")
    file = _file_of(module_name, folders)

    # what a law imports may lie beside it; after all installed, so that it hides nothing
    for folder in folders:
        if folder not in sys.path:
            sys.path.append(folder)

    try:
        if file is None:
            module = _import_module(module_name)
        else:
            module = _import_file(module_name, file)
    except ModuleNotFoundError as error:
        searched = " or ".join(dict.fromkeys(os.path.abspath(folder) for folder in folders))
        remedy = f"Put {module_name}.py there, correct law.name, or install its package."
        if error.name not in (module_name, module_name.partition(".")[0]):
            remedy = f"It imports {error.name}: install that package into the Python of Covey."
        raise ConfigError(
            f"{where}: the module {module_name} cannot be imported ({error}), neither from "
            f"{searched} nor as an installed one. {remedy}"
        ) from None
    except (Exception, SystemExit) as error:  # noqa: BLE001 - whatever somebody's module does
        raise ConfigError(
            f"{where}: the module {module_name} cannot be imported ({type(error).__name__}: "
            f"{error}). Correct it; try it alone with: python {file or f'-m {module_name}'}"
        ) from None

    function = getattr(module, function_name, None)
    if not callable(function):
        fault = "has no such name"
        if function is not None:
            fault = f"has it as {type(function).__name__}, which is no function"
        raise ConfigError(
            f"{where}: {module_name} {fault}. Name a function law(memory, inputs) of that module."
        )
    _check_signature(function, where)

    source = str(getattr(module, "__file__", None) or "")
    source_hash = _source_hash(source, is_in_package="." in module_name)
    return OwnLaw(name, source, source_hash, function)


def _file_of(module_name: str, folders: Sequence[str]) -> str | None:
    """Return the file of a module in the first folder that has it."""
    for folder in folders:
        file = os.path.join(os.path.abspath(folder), f"{module_name}.py")
        if os.path.isfile(file):
            return file
    return None


def _target(name: str, where: str) -> str:
    """Return module and function of a name, as ``module:function``."""
    parts = name.split(":")
    if len(parts) == 2 and all(part.replace(".", "_").isidentifier() for part in parts):
        return name

    known = {entry.name: entry.value for entry in entry_points(group=GROUP)}
    if name in known:
        return known[name]

    laws = ", ".join((*BUILT_IN, *sorted(known)))
    raise ConfigError(
        f"{where}, but there are only {laws}. Name one of these, or a law of your own as "
        "module:function (docs/own-law.md)."
    )


def _import_file(name: str, file: str) -> ModuleType:
    """Import a file by itself: another fleet's file of the same name is another module."""
    source_hash = _source_hash(file)
    key = (os.path.realpath(file), source_hash)
    if key in _modules:
        return _modules[key]

    spec = importlib.util.spec_from_file_location(f"{name}_{source_hash}", file)
    if spec is None or spec.loader is None:
        raise ImportError(f"{file} is no Python module")
    module = importlib.util.module_from_spec(spec)

    sys.modules[module.__name__] = module  # dataclasses look themselves up there
    try:
        spec.loader.exec_module(module)
    except BaseException:
        del sys.modules[module.__name__]
        raise

    _modules[key] = module
    return module


def _import_module(name: str) -> ModuleType:
    importlib.invalidate_caches()
    return importlib.import_module(name)


def _check_signature(function: Callable[..., Any], where: str) -> None:
    try:
        signature = inspect.signature(function)
    except (TypeError, ValueError):  # of compiled code nothing is known
        return
    try:
        signature.bind(None, None)
    except TypeError:
        raise ConfigError(
            f"{where}, which takes {signature}. A law is called as law(memory, inputs): give it "
            "these two arguments."
        ) from None


def _source_hash(source: str, *, is_in_package: bool = False) -> str:
    """Return the hash of a module's source: of its file, or of all Python files of its package."""
    folder = os.path.dirname(source)
    files: list[str] = []
    if is_in_package or os.path.basename(source) == "__init__.py":
        for inner, _, names in os.walk(folder):
            files += [os.path.join(inner, name) for name in names]
        files.sort()
    elif source:
        files = [source]

    digest = hashlib.sha256()
    for file in files:
        if not file.endswith(".py"):
            continue
        with open(file, "rb") as stream:
            text = stream.read()
        digest.update(f"{os.path.relpath(file, folder)} {len(text)}\n".encode() + text)
    return digest.hexdigest()[:12]
