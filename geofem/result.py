"""What a run leaves behind: one JSON line and one .npz, readable without dolfinx."""

from __future__ import annotations

import json
import math
import os
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from geofem.mistake import Mistake

STATUSES = ("ok", "failed", "partial", "refused")
KEYS = ("scene", "method", "knobs", "status", "cause", "at", "qoi", "reference", "error", "size", "work", "cost",
        "checks", "savings", "ranks", "versions", "message")  # fmt: skip


def plain(value: Any) -> Any:
    """The value in terms that JSON knows; nan and infinity become None."""
    if isinstance(value, dict):
        return {str(k): plain(v) for k, v in value.items()}
    if isinstance(value, (list, tuple, np.ndarray)):
        return [plain(v) for v in value]
    if isinstance(value, (bool, np.bool_)):
        return bool(value)
    if isinstance(value, (int, np.integer)):
        return int(value)
    if isinstance(value, (float, np.floating)):
        return float(value) if math.isfinite(value) else None
    return value if value is None or isinstance(value, str) else str(value)


@dataclass
class Result:
    """The outcome of one run; a method's breakdown is one too.

    status : ``ok``, ``failed`` (see ``cause``, ``message`` and ``at``), ``partial`` (interrupted), ``refused`` (see ``message``).
    error : relative to the reference; ``checks`` : relative drifts over the run.
    history : sampled arrays, ``t`` first. snapshot : ``points`` (n, 3), ``cells``, ``displacement`` (n, gdim) and fields
    at the end of the run, on rank 0; ``cell`` names the shape of the cells (meshio's name, "vertex" for points).
    """

    scene: str
    method: str
    knobs: dict[str, Any] = field(default_factory=dict)
    status: str = "ok"
    cause: str | None = None
    at: dict[str, float] = field(default_factory=dict)
    qoi: dict[str, float] = field(default_factory=dict)
    reference: dict[str, dict[str, Any]] = field(default_factory=dict)
    error: dict[str, float] = field(default_factory=dict)
    size: dict[str, int] = field(default_factory=dict)
    work: dict[str, int] = field(default_factory=dict)
    cost: dict[str, Any] = field(default_factory=dict)
    checks: dict[str, float | None] = field(default_factory=dict)
    savings: dict[str, float] = field(default_factory=dict)
    ranks: int = 1
    versions: dict[str, str] = field(default_factory=dict)
    message: str | None = None
    history: dict[str, np.ndarray] = field(default_factory=dict, repr=False)
    snapshot: dict[str, Any] = field(default_factory=dict, repr=False)

    @property
    def row(self) -> dict[str, Any]:
        """The dictionary behind the JSON line."""
        return {key: plain(getattr(self, key)) for key in KEYS}

    def to_json(self) -> str:
        return json.dumps(self.row, allow_nan=False)

    def save(self, folder: Path) -> Path:
        """Write ``result.json`` (one line) and ``result.npz`` into the folder, each whole or not at all."""
        folder.mkdir(parents=True, exist_ok=True)
        arrays = {f"history_{k}": v for k, v in self.history.items()}
        arrays |= {f"snapshot_{k}": np.asarray(v) for k, v in self.snapshot.items()}
        write_npz(folder / "result.npz", arrays)
        replace_text(folder / "result.json", self.to_json() + "\n")
        return folder / "result.json"

    @classmethod
    def load(cls, folder: Path) -> Result:
        """Read back what ``save`` wrote. Raises ``Mistake`` if the folder holds no result."""
        try:
            row = json.loads((folder / "result.json").read_text())
            result = cls(**row)
            with np.load(folder / "result.npz", allow_pickle=False) as arrays:
                for key in arrays.files:
                    kind, _, name = key.partition("_")
                    value = arrays[key]
                    getattr(result, kind)[name] = value.item() if value.dtype.kind == "U" else value
        except (OSError, ValueError, TypeError, KeyError) as error:
            raise Mistake(f"{folder}: no readable result there ({error}); run 'geofem run ... --out {folder}' first") from None
        return result


def replace_text(path: Path, text: str) -> None:
    """Write a file whole or not at all."""
    part = path.with_name(path.name + ".part")
    part.write_text(text)
    os.replace(part, path)


def write_npz(path: Path, arrays: dict[str, np.ndarray]) -> None:
    """Write an .npz whole or not at all."""
    part = path.with_name(path.name + ".part")
    with part.open("wb") as file:
        np.savez_compressed(file, allow_pickle=False, **arrays)
    os.replace(part, path)
