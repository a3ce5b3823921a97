"""The public functions and classes of the kernels, module by module.

A function is public when its docstring has sections: what is internal has one line.  All classes are, for functions
take and return them.
"""

from __future__ import annotations

import importlib
import inspect
import pkgutil
from collections.abc import Iterator
from functools import cached_property
from types import FunctionType, ModuleType

import tilepipe_kernels


def packages() -> list[ModuleType]:
    """The packages of kernels in the order of their names."""
    found = pkgutil.iter_modules(tilepipe_kernels.__path__, "tilepipe_kernels.")
    return [importlib.import_module(module.name) for module in found if module.ispkg]


def modules(package: ModuleType) -> Iterator[ModuleType]:
    """All modules of a package that hold something public; CUDA twins do not, for callers see none of them."""
    return (module for module in _modules(package) if any(public(module)))


def _modules(package: ModuleType) -> Iterator[ModuleType]:
    for module in pkgutil.walk_packages(package.__path__, f"{package.__name__}."):
        if "device" not in module.name.split(".") and not module.ispkg:
            yield importlib.import_module(module.name)


def public(module: ModuleType) -> Iterator[tuple[str, str]]:
    """Kind (``function`` or ``class``) and name of what a module offers."""
    for name, item in vars(module).items():
        if name.startswith("_") or getattr(item, "__module__", None) != module.__name__:
            continue
        if inspect.isclass(item):
            yield "class", name
        elif inspect.isfunction(item) and "\n----" in (inspect.getdoc(item) or ""):
            yield "function", name


def methods(kind: type) -> list[str]:
    """Public methods and properties of a class; its fields stand in its docstring."""
    sorts = (FunctionType, classmethod, staticmethod, property, cached_property)
    return [name for name, item in vars(kind).items() if not name.startswith("_") and isinstance(item, sorts)]
