"""The scenes by name: one module each, found by its file name; light to import, as no scene needs dolfinx."""

from __future__ import annotations

import inspect
import pkgutil
from collections.abc import Callable
from importlib import import_module
from types import ModuleType

from geofem.mistake import unknown
from geofem.scene import Scene


def known() -> dict[str, str]:
    """Every scene's name with its summary, the first line of its page."""
    return {name: page(module(name)).splitlines()[0] for name in names()}


def get(name: str) -> Callable[..., Scene]:
    """The function that builds the scene; its keyword arguments are the scene's knobs. Raises ``Mistake`` if there is none."""
    if name not in names():
        raise unknown("scene", name, names())
    return module(name).scene


def describe(name: str) -> str:
    """The page of a scene: its text, and its knobs with units and defaults. Raises ``Mistake`` if there is none."""
    build = get(name)
    return f"{page(module(name))}\n\n{inspect.getdoc(build)}"


def names() -> list[str]:
    """The names of all scenes, sorted; a module whose name starts with an underscore is not one."""
    return sorted(found.name for found in pkgutil.iter_modules(__path__) if not found.name.startswith("_"))


def module(name: str) -> ModuleType:
    return import_module(f"{__name__}.{name}")


def page(of: ModuleType) -> str:
    """The docstring of a scene's module."""
    text = inspect.getdoc(of)
    assert text, f"{of.__name__} has no page"
    return text
