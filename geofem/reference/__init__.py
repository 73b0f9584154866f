"""Reference values of the scenes: one TOML file a scene, or a CSV file for a curve; every figure with its kind and source."""

from __future__ import annotations

import tomllib
from functools import cache
from importlib.resources import files
from typing import Any

import numpy as np

from geofem.mistake import Mistake, unknown
from geofem.scene import Array, Reference

FOLDER = files(__package__)


@cache
def table(file: str) -> dict[str, dict[str, Any]]:
    """All entries of ``file``.toml by name."""
    return tomllib.loads(FOLDER.joinpath(f"{file}.toml").read_text("utf-8"))


def reference(file: str, name: str) -> Reference:
    """The entry ``name`` of ``file``.toml. Raises ``Mistake`` if there is none."""
    entries = table(file)
    if name not in entries:
        raise unknown(f"reference in {file}.toml", name, entries)
    return Reference(**entries[name])


def series(file: str) -> tuple[str, dict[str, Array]]:
    """The source and the columns of ``file``.csv: comment lines that tell the source, a line of names, then numbers.

    Raises ``Mistake`` if the file is missing.
    """
    path = FOLDER.joinpath(f"{file}.csv")
    if not path.is_file():
        raise Mistake(f"reference {file}.csv: not there; a scene that compares with it cannot run, so reinstall geofem")
    lines = path.read_text("utf-8").splitlines()
    source = " ".join(line[1:].strip() for line in lines if line.startswith("#"))
    names, *rows = [line.split(",") for line in lines if line and not line.startswith("#")]
    columns = np.array(rows, float).T
    return source, {name.strip(): column for name, column in zip(names, columns, strict=True)}
