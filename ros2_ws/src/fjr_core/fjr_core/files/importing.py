# SPDX-License-Identifier: Apache-2.0
"""Import code by its name when it is needed: classes of the user, and modules of packages above this one."""

from __future__ import annotations

import hashlib
import importlib
import inspect
import os
import re
import sys
import traceback
from collections.abc import Mapping
from pathlib import Path
from types import ModuleType
from typing import Any

from ..errors import MissingPackageError, ParameterError

SEPARATOR = ":"
INSTALLED = {"site-packages", "dist-packages"}
OWN = {"fjr_core", "fjr_msgs_py", "fjr_plant", "fjr_controller", "fjr_design", "fjr_monitor", "fjr_identification"}
OWN |= {"fjr_proofs", "fjr_engines", "fjr_bringup"}


def is_named(name: object) -> bool:
    """Return whether this is the name of a class of the user, module:Class, and not of a built-in choice."""
    return isinstance(name, str) and SEPARATOR in name


def load(name: str) -> type:
    """Return the class of this name, from the Python path or, after it, the current directory.

    Raises ParameterError if the module cannot be imported or has no such class.
    """
    module, _, attribute = name.partition(SEPARATOR)
    if not all(part.isidentifier() for part in [*module.split("."), attribute]):
        raise ParameterError(
            f"{name!r} is not the name of a class; expected module:Class, e.g. my_package.my_law:MyLaw"
        )
    found = getattr(_user_module(name, module), attribute, None)
    if not inspect.isclass(found):
        raise ParameterError(f"module {module} has no class {attribute}; expected one, for {name!r}")
    return found


def build(name: str, first: Any, options: Mapping[str, Any]) -> Any:
    """Return an instance: the class called with `first` and the options as keywords. Raises ParameterError."""
    kind = load(name)
    title, taken = kind.__name__, inspect.signature(kind)
    try:
        taken.bind(first, **options)
    except TypeError as error:
        raise ParameterError(f"{title} takes {taken} ({error}); expected (robot) and options with defaults") from None
    try:
        return kind(first, **options)
    except ParameterError:
        raise
    except (Exception, SystemExit) as error:
        raise ParameterError(f"{title}(...) raises {described(error)}; expected an object") from None


def option_defaults(name: str) -> dict[str, Any]:
    """Return the defaults of the constructor's arguments after the first. Raises ParameterError for one without."""
    kind, found = load(name), {}
    for each in list(inspect.signature(kind).parameters.values())[1:]:
        if each.kind in (each.VAR_KEYWORD, each.VAR_POSITIONAL):
            continue
        if each.default is each.empty:
            raise ParameterError(
                f"argument '{each.name}' of {kind.__name__} has no default; expected one: it is an option"
            )
        found[each.name] = each.default
    return found


def check_method(own: Any, name: str, arguments: tuple[str, ...]) -> None:
    """Raise ParameterError unless the object has this method, and it can be called with these arguments."""
    title, method, wanted = type(own).__name__, getattr(own, name, None), ", ".join(arguments)
    if not callable(method):
        raise ParameterError(f"{title} has no method {name}; expected {name}({wanted})")
    try:
        inspect.signature(method).bind(*arguments)
    except TypeError:
        raise ParameterError(f"{title}.{name} takes {inspect.signature(method)}; expected ({wanted})") from None


def described(error: BaseException) -> str:
    """Return an exception in one line, with the file and the line of the code that raised it."""
    text = f"{type(error).__name__}: {' '.join(str(error).split())}".rstrip(": ")
    frames = traceback.extract_tb(error.__traceback__)
    if not frames or isinstance(error, SyntaxError):
        return text
    return f"{text} ({Path(frames[-1].filename).name}, line {frames[-1].lineno})"


def source_digest(kind: type) -> str:
    """Return a hash of the sources of the class; results of another version are not reused.

    These are its module, the loaded modules that its text names, their packages, and so on, but no installed ones.
    """
    digest, names, package = hashlib.sha256(), [kind.__module__], kind.__module__.partition(".")[0]
    for name in names:  # which grows
        file, top = Path(getattr(sys.modules.get(name), "__file__", None) or "prompt"), name.partition(".")[0]
        installed = top in sys.stdlib_module_names or top in OWN or INSTALLED & {*file.parts}
        if file.is_file() and (top == package or not installed):
            source = file.read_bytes()
            digest.update(source)
            words = set(re.findall(r"\w+", source.decode(errors="replace")))
            named = (each for each in [*sys.modules] if each.rpartition(".")[2] in words or name.startswith(f"{each}."))
            names += sorted(set(named).difference(names))
    return digest.hexdigest()


def _user_module(name: str, module: str) -> Any:
    if os.getcwd() not in sys.path:
        sys.path.append(os.getcwd())
    importlib.invalidate_caches()  # the file may be newer than the process
    try:
        return importlib.import_module(module)
    except ModuleNotFoundError as error:
        if error.name and (module == error.name or module.startswith(f"{error.name}.")):
            place = f"on the Python path (PYTHONPATH) or in {os.getcwd()}"
            raise ParameterError(f"module {error.name} of {name!r} is not found; expected it {place}") from None
        raise ParameterError(f"module {module} cannot be imported: {error}; expected it installed") from None
    except (Exception, SystemExit) as error:
        raise ParameterError(f"module {module} raises {described(error)}; expected it to be importable") from None


def module(name: str) -> ModuleType:
    """Import a module by its full name; raise MissingPackageError, which names its package, if that is not there."""
    package = name.partition(".")[0]
    try:
        return importlib.import_module(name)
    except ModuleNotFoundError as error:
        if error.name != package:
            raise
        raise MissingPackageError(
            f"this needs the package {package}, which is not installed; expected it beside fjr_core"
        ) from None


def module_if_there(name: str) -> ModuleType | None:
    """Import a module by its full name; return None if its package is not installed."""
    try:
        return module(name)
    except MissingPackageError:
        return None
