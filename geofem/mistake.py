"""The two ways a run can go wrong: the user's mistake, which raises, and the method's breakdown, which is a result."""

from __future__ import annotations

import difflib
from collections.abc import Iterable

CAUSES = ("tangle", "newton", "cfl", "arrest", "energy", "fracture", "nullspace", "cond", "volume", "timeout")


class Mistake(Exception):
    """Something the user can mend: one line that says what, where and what to do; exit status 2."""


class Breakdown(Exception):
    """A method has come to its end: the runner turns it into a ``Result`` with this cause.

    Parameters
    ----------
    cause : one of ``CAUSES``; after an ``arrest`` of all cracks, the result is ok.
    message : what happened and where, in one line.
    """

    def __init__(self, cause: str, message: str):
        assert cause in CAUSES, cause
        super().__init__(message)
        self.cause = cause


def unknown(what: str, name: str, known: Iterable[str]) -> Mistake:
    """A mistake that names the nearest known word: ``unknown knob 'ordre': did you mean 'order'?``"""
    known = sorted(known)
    near = difflib.get_close_matches(name, known, n=1)
    hint = f"did you mean {near[0]!r}?" if near else f"choose from {', '.join(known)}"
    return Mistake(f"unknown {what} {name!r}: {hint}")
