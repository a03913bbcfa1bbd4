"""Finds a user's own law by the name in a fleet file, hashes its source, and imports it.

Finding a law does not run its code: its file is only read and hashed. So a fleet file of unknown
origin can be loaded and checked. The law is imported when a vehicle flies with it, or when a person
requests it. Its code then has the rights of the importing process. docs/own-law.md describes the
interface of a law.
"""

from __future__ import annotations

import hashlib
import importlib
import importlib.util
import inspect
import os
import sys
from collections.abc import Callable, Sequence
from importlib.machinery import ModuleSpec, PathFinder
from importlib.metadata import entry_points
from types import ModuleType
from typing import Any

import msgspec

from onboard.config.file_reading import LAW_SOURCE, read_bytes
from onboard.config.law import BUILT_IN
from onboard.config.toml_reading import ConfigError
from onboard.plain_text import meant_words

GROUP = "covey.laws"  # group of entry points

LawFunction = Callable[[Any, Any], Any]  # law(memory, inputs)

# (file, hash of its source) -> imported module; a file is imported once in a process
_modules: dict[tuple[str, str], ModuleType] = {}


class OwnLaw(msgspec.Struct, frozen=True):
    """A law that a fleet file names; its code has not run yet."""

    name: str  # name in the fleet file
    source: str  # file of its module; empty for a module without a file
    source_hash: str  # hash of that file, or of all files of its package
    load: Callable[[], LawFunction]  # imports the law, which runs its code; raises ConfigError
    file: str | None = None  # its module beside the fleet file; None for an installed module


class LawImport(msgspec.Struct, frozen=True):
    """Imports a law when it is called, which runs the code of its module."""

    where: str  # start of messages: fleet file and name of the law
    module_name: str
    function_name: str
    file: str | None  # file of a module beside the fleet file; None for an installed module
    folders: tuple[str, ...]  # further folders searched for the law's own imports

    def __call__(self) -> LawFunction:
        """Return the law's function.

        Raises:
            ConfigError: The module cannot be imported, or has no such function.
        """
        module = self._module()
        function = getattr(module, self.function_name, None)
        if not callable(function):
            fault = "has no such name"
            if function is not None:
                fault = f"has it as {type(function).__name__}, which is no function"
            raise ConfigError(
                f"{self.where}: {self.module_name} {fault}. Name a function law(memory, inputs) "
                "of that module."
            )

        _check_signature(function, self.where)
        law: LawFunction = function
        return law

    def _module(self) -> ModuleType:
        # the law may import modules beside it; these folders come last in sys.path, so that they
        # hide no installed module
        for folder in self.folders:
            if folder not in sys.path:
                sys.path.append(folder)

        try:
            if self.file is None:
                return _import_module(self.module_name)
            return _import_file(self.module_name, self.file)
        except ModuleNotFoundError as error:
            if error.name in (self.module_name, self.module_name.partition(".")[0]):
                raise _not_found(self.where, self.module_name, self.folders, error) from None
            raise ConfigError(
                f"{self.where}: the module {self.module_name} cannot be imported ({error}). It "
                f"imports {error.name}: install that package into the Python of Covey."
            ) from None
        except (Exception, SystemExit) as error:  # noqa: BLE001 - a user's module may raise anything
            run_words = f"-m {self.module_name}"
            if self.file is not None:
                run_words = self.file
            raise ConfigError(
                f"{self.where}: the module {self.module_name} cannot be imported "
                f"({type(error).__name__}: {error}). Correct it; try it alone with: "
                f"python {run_words}"
            ) from None


def find_own_law(name: str, folders: Sequence[str], named_by: str) -> OwnLaw:
    """Find a law and hash its source, without running its code.

    Args:
        name: ``module:function``, or an entry point of the group ``covey.laws``.
        folders: folders in which the module is searched before the installed modules.
        named_by: file and key, or option, whose value the name is, for messages.
    Raises:
        ConfigError: There is no law of that name, or its module does not exist.
    """
    where = f"{named_by} is {name!r}"
    folders = [os.path.abspath(folder) for folder in folders]
    module_name, _, function_name = _target(name, where).partition(":")

    file = _file_of(module_name, folders)
    source = file
    if source is None:
        source = _installed_source(module_name, folders)
    if source is None:
        missing = f"No module named {module_name!r}"
        raise _not_found(where, module_name, folders, missing)

    return OwnLaw(
        name=name,
        source=source,
        source_hash=_source_hash(source, is_in_package="." in module_name),
        load=LawImport(
            where=where,
            module_name=module_name,
            function_name=function_name,
            file=file,
            folders=tuple(folders),
        ),
        file=file,
    )


def _not_found(
    where: str, module_name: str, folders: Sequence[str], error: ModuleNotFoundError | str
) -> ConfigError:
    searched = " or ".join(dict.fromkeys(folders))
    return ConfigError(
        f"{where}: the module {module_name} cannot be imported ({error}), neither from "
        f"{searched} nor as an installed one. Put {module_name}.py there, correct the name, or "
        "install its package."
    )


def _installed_source(module_name: str, folders: Sequence[str]) -> str | None:
    """Return the file of an installed module. Empty: the module has no file. None: there is no
    module.

    Unlike ``importlib.util.find_spec``, this does not import the packages around the module. As in
    an import, an installed package takes precedence over a package of the same name in the folders.
    """
    importlib.invalidate_caches()
    package, *inner = module_name.split(".")
    spec = _spec_of(package, None)
    if spec is None:
        spec = PathFinder.find_spec(package, folders)

    full_name = package
    for name in inner:
        if spec is None or spec.submodule_search_locations is None:
            return None
        full_name = f"{full_name}.{name}"
        spec = _spec_of(full_name, list(spec.submodule_search_locations))

    if spec is None:
        return None
    if spec.has_location and spec.origin is not None:
        return spec.origin
    return ""


def _spec_of(full_name: str, path: Sequence[str] | None) -> ModuleSpec | None:
    """Return the spec of a module without importing its package; None if there is none."""
    for finder in sys.meta_path:
        try:
            spec = finder.find_spec(full_name, path)
        except KeyError:
            # the module's package is a folder without __init__.py that is not imported yet
            parent_folders: Sequence[str] = ()
            if path is not None:
                parent_folders = path
            spec = _folder_spec(full_name, parent_folders)
        if spec is not None:
            return spec
    return None


def _folder_spec(full_name: str, path: Sequence[str]) -> ModuleSpec | None:
    """Return the spec of a package that is only a folder; None if there is no such folder."""
    _, _, name = full_name.rpartition(".")
    folders = [os.path.join(folder, name) for folder in path]
    spec = ModuleSpec(full_name, None, is_package=True)
    spec.submodule_search_locations = [folder for folder in folders if os.path.isdir(folder)]
    if not spec.submodule_search_locations:
        return None
    return spec


def _file_of(module_name: str, folders: Sequence[str]) -> str | None:
    """Return the file of a module in the first folder that has it."""
    for folder in folders:
        file = os.path.join(folder, f"{module_name}.py")
        if os.path.isfile(file):
            return file
    return None


def _target(name: str, where: str) -> str:
    """Return module and function of a name, as ``module:function``."""
    module_name, _, function_name = name.partition(":")
    if module_name.endswith(".py"):
        function_name = function_name or "law"
        raise ConfigError(
            f"{where}: write the module's name without .py: "
            f"{_module_of_path(module_name)}:{function_name}"
        )

    parts = name.split(":")
    if len(parts) == 2 and all(part.replace(".", "_").isidentifier() for part in parts):
        return name

    known = {entry.name: entry.value for entry in entry_points(group=GROUP)}
    if name in known:
        return known[name]

    laws = (*BUILT_IN, *sorted(known))
    raise ConfigError(
        f"{where}, but there are only {', '.join(laws)}.{meant_words(name, laws)} Name one of"
        " these, or a law of your own as module:function (docs/own-law.md)."
    )


def _module_of_path(path: str) -> str:
    """Return the name of the module in a file, from the folder in which its package is.

    A file elsewhere can only be named from its own folder.
    """
    names = os.path.normpath(path.removesuffix(".py")).split(os.sep)
    if os.pardir in names or os.path.isabs(path):
        return names[-1]
    return ".".join(names)


def _import_file(name: str, file: str) -> ModuleType:
    """Import a file under a module name of its own, since two fleets may have files of the same
    name.
    """
    source_hash = _source_hash(file)
    key = (os.path.realpath(file), source_hash)
    if key in _modules:
        return _modules[key]

    spec = importlib.util.spec_from_file_location(f"{name}_{source_hash}", file)
    if spec is None or spec.loader is None:
        raise ImportError(f"{file} is no Python module")
    module = importlib.util.module_from_spec(spec)

    sys.modules[module.__name__] = module  # dataclasses need their module there
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
    except (TypeError, ValueError):  # compiled code may have no readable signature
        return
    try:
        signature.bind(None, None)
    except TypeError:
        raise ConfigError(
            f"{where}, which takes {signature}. A law is called as law(memory, inputs): give it "
            "these two arguments."
        ) from None


def _source_hash(source: str, *, is_in_package: bool = False) -> str:
    """Return the hash of a module's file, or of all Python files of its package."""
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
        text = read_bytes(file, LAW_SOURCE)
        digest.update(f"{os.path.relpath(file, folder)} {len(text)}\n".encode() + text)
    return digest.hexdigest()[:12]
