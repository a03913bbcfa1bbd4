"""A law of somebody's own: found by its name in a fleet file, told apart by its source, imported.

Finding a law runs none of its code: its file is read and hashed, and nothing else. A fleet file of
a stranger can therefore be loaded and judged. The law is imported when something is to fly by it,
or when a person asks for it; its code then has the rights of whoever does that. The protocol of a
law is in docs/own-law.md.
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

GROUP = "covey.laws"  # of entry points

LawFunction = Callable[[Any, Any], Any]  # law(memory, inputs)

# (file, hash of its source) -> what was made of it, once in a process
_modules: dict[tuple[str, str], ModuleType] = {}


class OwnLaw(msgspec.Struct, frozen=True):
    """A law that a fleet file names; none of its code has run."""

    name: str  # as the fleet file has it
    source: str  # file of its module
    source_hash: str  # of that file, or of all of its package
    load: Callable[[], LawFunction]  # runs the code of its module; raises ConfigError


class LawImport(msgspec.Struct, frozen=True):
    """Imports a law when it is called, which runs the code of its module."""

    where: str  # begin of the sentences: fleet file and name of the law
    module_name: str
    function_name: str
    file: str | None  # of a module beside the fleet file; None for an installed one
    folders: tuple[str, ...]  # where else the law's own imports are looked for

    def __call__(self) -> LawFunction:
        """Return the law's function.

        Raises:
            ConfigError: the module cannot be imported, or has no such law.
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
        # what a law imports may lie beside it; after all installed, so that it hides nothing
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
        except (Exception, SystemExit) as error:  # noqa: BLE001 - whatever somebody's module does
            raise ConfigError(
                f"{self.where}: the module {self.module_name} cannot be imported "
                f"({type(error).__name__}: {error}). Correct it; try it alone with: "
                f"python {self.file or f'-m {self.module_name}'}"
            ) from None


def find_own_law(name: str, folders: Sequence[str], path: str) -> OwnLaw:
    """Find a law and hash its source, without running any of its code.

    Args:
        name: ``module:function``, or an entry point of the group ``covey.laws``.
        folders: where the module is looked for before the installed ones.
        path: of the fleet file, for the sentences.
    Returns:
        the law.
    Raises:
        ConfigError: no law has that name, or its module is not there.
    """
    where = f"{path}: 'law.name' is {name!r}"
    folders = [os.path.abspath(folder) for folder in folders]
    module_name, _, function_name = _target(name, where).partition(":")

    file = _file_of(module_name, folders)
    source = file or _installed_source(module_name, folders)
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
    )


def _not_found(
    where: str, module_name: str, folders: Sequence[str], error: ModuleNotFoundError | str
) -> ConfigError:
    searched = " or ".join(dict.fromkeys(folders))
    return ConfigError(
        f"{where}: the module {module_name} cannot be imported ({error}), neither from "
        f"{searched} nor as an installed one. Put {module_name}.py there, correct law.name, or "
        "install its package."
    )


def _installed_source(module_name: str, folders: Sequence[str]) -> str | None:
    """Return the file of an installed module.

    Empty for a module without a file; None where there is no such module.

    ``importlib.util.find_spec`` imports the packages around a module. This does not.
    """
    importlib.invalidate_caches()
    package, *inner = module_name.split(".")
    spec = _spec_of(package, None) or PathFinder.find_spec(package, folders)

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
    for finder in sys.meta_path:
        spec = finder.find_spec(full_name, path)
        if spec is not None:
            return spec
    return None


def _file_of(module_name: str, folders: Sequence[str]) -> str | None:
    """Return the file of a module in the first folder that has it."""
    for folder in folders:
        file = os.path.join(folder, f"{module_name}.py")
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
        text = read_bytes(file, LAW_SOURCE)
        digest.update(f"{os.path.relpath(file, folder)} {len(text)}\n".encode() + text)
    return digest.hexdigest()[:12]
