"""A law of somebody's own: found by the name that a fleet file gives it, imported, and told apart
by its source.

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
# (file, hash) -> what was made of it, once in a process
_modules: dict[tuple[str, str], ModuleType] = {}


class OwnLaw(msgspec.Struct, frozen=True):
    """A law that a fleet file names."""

    name: str  # as the fleet file has it
    source: str  # file of its module
    source_hash: str  # of that file, or of all of its package
    function: Callable[[Any, Any], Any]


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
    files = [os.path.join(os.path.abspath(folder), f"{module_name}.py") for folder in folders]
    file = next((file for file in files if os.path.isfile(file)), None)
    # what a law imports may lie beside it; after all installed, so that it hides nothing
    for folder in folders:
        if folder not in sys.path:
            sys.path.append(folder)
    try:
        module = _import_module(module_name) if file is None else _import_file(module_name, file)
    except ModuleNotFoundError as error:
        looked = " or ".join(dict.fromkeys(os.path.abspath(folder) for folder in folders))
        remedy = f"Put {module_name}.py there, correct law.name, or install its package."
        if error.name not in (module_name, module_name.partition(".")[0]):
            remedy = f"It imports {error.name}: install that package into the Python of Covey."
        raise ConfigError(
            f"{where}: the module {module_name} cannot be imported ({error}), neither from {looked} nor as an "
            f"installed one. {remedy}"
        ) from None
    except (Exception, SystemExit) as error:  # noqa: BLE001 - whatever somebody's module does
        raise ConfigError(
            f"{where}: the module {module_name} cannot be imported ({type(error).__name__}: {error}). Correct it; "
            f"try it alone with: python {file or f'-m {module_name}'}"
        ) from None
    function = getattr(module, function_name, None)
    if not callable(function):
        what = (
            "has no such name"
            if function is None
            else f"has it as {type(function).__name__}, which is no function"
        )
        raise ConfigError(
            f"{where}: {module_name} {what}. Name a function law(memory, inputs) of that module."
        )
    _check_signature(function, where)
    source = str(getattr(module, "__file__", None) or "")
    return OwnLaw(name, source, _source_hash(source, is_in_package="." in module_name), function)


def _target(name: str, where: str) -> str:
    """Return module and function of a name."""
    if (
        all(part and part.replace(".", "_").isidentifier() for part in name.split(":"))
        and name.count(":") == 1
    ):
        return name
    known = {entry.name: entry.value for entry in entry_points(group=GROUP)}
    if name in known:
        return known[name]
    laws = ", ".join((*BUILT_IN, *sorted(known)))
    raise ConfigError(
        f"{where}, but there are only {laws}. Name one of these, or a law of your own as module:function "
        "(docs/own-law.md)."
    )


def _import_file(name: str, file: str) -> ModuleType:
    """Import a file by itself: another fleet's file of the same name is another module."""
    key = os.path.realpath(file), _source_hash(file)
    if key not in _modules:
        spec = importlib.util.spec_from_file_location(f"{name}_{key[1]}", file)
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
    return _modules[key]


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
            f"{where}, which takes {signature}. A law is called as law(memory, inputs): give it these two arguments."
        ) from None


def _source_hash(source: str, *, is_in_package: bool = False) -> str:
    """Return the hash of a module's source: of its file, or of all Python files of its package."""
    folder = os.path.dirname(source)
    files = [source] if source else []
    if is_in_package or os.path.basename(source) == "__init__.py":
        files = sorted(os.path.join(at, name) for at, _, names in os.walk(folder) for name in names)
    digest = hashlib.sha256()
    for file in files:
        if file.endswith(".py"):
            with open(file, "rb") as stream:
                text = stream.read()
            digest.update(f"{os.path.relpath(file, folder)} {len(text)}\n".encode() + text)
    return digest.hexdigest()[:12]
