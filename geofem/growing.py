"""Cracks from Python: step by step as they grow, and one body with many cracks in turn."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from typing import Any

from geofem import methods
from geofem.core.propagation import Step
from geofem.mistake import Breakdown, Mistake
from geofem.runner import SceneLike, prepare, resolve, tidy
from geofem.scene import Growth, Scene

log = logging.getLogger("geofem")


def grow(
    scene: SceneLike, method: str = "xfem", *, until: float | Callable[[Step], bool] | None = None, **knobs: Any
) -> Iterator[Step]:
    """Let the cracks of a scene grow under its full load, and give each state on the way, the first one before any growth.

    >>> for step in geofem.grow("inclined_crack", da=0.1, until=2.0):  # doctest: +SKIP
    ...     print(step.advance, step.K, step.path, step.energy)

    Parameters
    ----------
    scene : as for ``geofem.run``; one without ``growth`` grows by the largest hoop stress.
    until : how far the fastest tip goes (m), or what is true of the last step; by default the length of the scene's growth.
    knobs : of the scene and of the method; ``da`` is the way of the fastest tip in a step (m).

    It ends early where all cracks have come to rest. Raises ``Mistake`` for what cannot grow, ``Breakdown`` where the method fails.
    Collective.
    """
    made, method_knobs = resolve(scene, method, knobs)
    if until is None and made.growth is None:
        raise Mistake(
            f"scene {made.name} does not say how far its cracks grow: give until, a length (m) or a predicate of a step"
        )
    law = made.growth or Growth(length=made.length)
    if until is not None and not callable(until):
        law = replace(law, length=until)
    made = replace(made, growth=law)
    model = built(methods.get(method), made, method_knobs)
    while True:
        step = model.propagation.now(model.t, model.energy(), model)
        yield step
        if until(step) if callable(until) else law.length - step.advance <= 1e-9 * law.length:
            return
        try:
            model.step(model.dt() if callable(until) else min(model.dt(), law.length - model.t))
        except Breakdown as end:
            if end.cause != "arrest":
                raise
            log.info("cracks at rest after %g m: %s", model.t, end)
            return


def vary(scene: SceneLike, knob: str, values: Iterable[Any], method: str = "xfem", **knobs: Any) -> Iterator[tuple[Any, Step]]:
    """Solve a scene for many values of one of its knobs, and give each value with the state of the cracks, as it is solved.

    Where the values move cracks, supports and loads only, ``xfem`` meshes the body and assembles its stiffness but once.

    >>> K = {beta: step.K for beta, step in geofem.vary("inclined_crack", "beta", range(0, 91), n=60)}  # doctest: +SKIP

    Raises ``Mistake`` and ``Breakdown`` as ``grow`` does. Collective.
    """
    solver = methods.get(method)
    for value in values:
        made, method_knobs = resolve(scene, method, {**knobs, knob: value})
        model = built(solver, made, method_knobs)
        while made.growth is None and model.t < made.t_end * (1.0 - 1e-9):
            model.step(min(model.dt(), made.t_end - model.t))
        yield value, model.propagation.now(model.t, model.energy(), model)


def built(method: methods.Method, scene: Scene, knobs: dict[str, Any]) -> Any:
    """The model of a scene with cracks. Raises ``Mistake`` if the method cannot solve it. Collective."""
    reason = method.refuses(scene)
    if reason is not None:
        raise Mistake(f"scene {scene.name}, method {method.name}: {reason}")
    prepare()
    tidy()
    model = method.build(scene, **knobs)
    if not hasattr(model, "propagation"):
        raise Mistake(f"method {method.name} has no cracks that grow; use xfem")
    return model
