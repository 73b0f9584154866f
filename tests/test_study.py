"""Sweeps, charts' numbers, maps and recommendations, on made-up rows of known order and with a stand-in for the worker."""

from __future__ import annotations

import inspect
import json
import math
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from geofem import methods, scenes
from geofem.mistake import Mistake
from geofem.result import Result
from geofem.scene import Scene
from geofem.scenes import cook
from geofem.study import chart, recommend, rows, stability, sweep
from geofem.study.ladders import LADDERS, SAMPLE, Ladder, default_ladders
from geofem.study.map import Map, Scale, Variant
from geofem.study.maps import MAPS

STAND_IN = """
import json, os, signal, sys, time
from pathlib import Path
from geofem.result import Result
task = json.load(sys.stdin)
print("a library says hello", flush=True)
for i, knobs in enumerate(task["runs"]):
    if knobs.get("behaviour") == "die" and i == 1:
        os.kill(os.getpid(), signal.SIGKILL)
    if knobs.get("behaviour") == "sleep" and i == 1:
        time.sleep(60)
    if knobs.get("behaviour") == "mistake":
        print("unknown knob 'behaviour': did you mean 'n'?", file=sys.stderr)
        sys.exit(2)
    distance = knobs.get("distance", 1.0)
    if knobs.get("edge") and distance < 1e-3:
        os.kill(os.getpid(), signal.SIGKILL)
    error = knobs["n"] ** -2.0 + knobs.get("locks", 0.0) / distance
    result = Result(task["scene"], task["method"], knobs=knobs, qoi={"u": 1 + error}, error={"u": error},
                    size={"dofs": knobs["n"] ** 2}, cost={"cpu_s": 1e-3 * knobs["n"] ** 2, "rss_mb": 100.0, "runs": task["repeats"]})
    if distance > knobs.get("breaks", 1e9):
        result.status, result.cause, result.at = "failed", "fracture", {"t": 1.0, "distance": knobs["breaks"]}
    result.save(Path(task["folder"]) / str(i))
    print(result.to_json(), flush=True)
"""
"""Behaves like geofem.worker, and as badly as its knobs ask."""


@pytest.fixture
def worker(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    script = tmp_path / "worker.py"
    script.write_text(STAND_IN)
    monkeypatch.setattr(sweep, "WORKER", [sys.executable, str(script)])
    monkeypatch.setenv("PYTHONPATH", str(Path(__file__).parents[1]))


def ladder(label: str, order: float, factor: float, values: tuple[int, ...] = (2, 4, 8, 16), **changes: Any) -> list[rows.Row]:
    """Rows of error = factor n**-order, dofs = n**2 and CPU seconds = 1e-3 n**2."""
    made = []
    for n in values:
        error = factor * n**-order
        row = Result("cook", "fem", knobs={"variant": "A", "n": n}, qoi={"uy": 24 * (1 - error)}, error={"uy": error}).row
        row["reference"] = {"uy": {"value": 24.0, "kind": "overkill", "source": "made up"}}
        row["size"], row["cost"] = {"dofs": n**2}, {"cpu_s": 1e-3 * n**2, "rss_mb": 100.0 + n}
        row |= {
            "label": label,
            "vary": "n",
            "scene_knobs": {"variant": "A"},
            "repeats": 3,
            "machine": "a machine",
            "run": "runs/0",
        }
        made.append(row | changes)
    return made


def fail(row: rows.Row, **changes: Any) -> rows.Row:
    return row | {"status": "failed", "error": {}, "qoi": {}} | changes


# --- rows -------------------------------------------------------------------------------------------------------------
@pytest.mark.parametrize("order", [0.5, 1.0, 2.0, 3.7])
def test_fitted_order_is_the_order_of_the_rows(order: float) -> None:
    # a power law is a straight line in the logarithms: least squares finds it to rounding
    line = ladder("P1", order, 0.3)
    assert rows.observed_order(line, "uy") == pytest.approx(order, rel=1e-12)
    assert rows.slope([row["size"]["dofs"] for row in line], [row["error"]["uy"] for row in line]) == pytest.approx(-order / 2)


def test_no_order_from_two_runs_or_from_another_knob() -> None:
    assert rows.observed_order(ladder("P1", 2, 1, (2, 4)), "uy") is None
    assert rows.observed_order(ladder("P1", 2, 1, vary="ppc"), "uy") is None


def test_pareto_front_holds_what_nothing_beats() -> None:
    found = ladder("good", 2, 0.1, (2, 4, 8)) + ladder("bad", 2, 0.5, (2, 4, 8)) + [fail(ladder("dead", 2, 1e-9, (2,))[0])]
    front = rows.pareto(found, "uy")
    assert [rows.label(row) for row in front] == ["good"] * 3
    for row in front:  # the definition: no other run is at once no worse in both and better in one
        for other in found:
            error = rows.error(other, "uy")
            if error is not None:
                assert not (error < row["error"]["uy"] and other["cost"]["cpu_s"] <= row["cost"]["cpu_s"])


def test_later_row_of_the_same_run_replaces_the_earlier(tmp_path: Path) -> None:
    first, second = ladder("P1", 2, 1, (2,))[0], ladder("P1", 2, 5, (2,))[0]
    for row in (first, second):
        rows.append(tmp_path, row)
    assert len((tmp_path / rows.RESULTS).read_text().splitlines()) == 2
    assert [row["error"] for row in rows.read(tmp_path)] == [second["error"]]


def test_broken_line_of_results_is_named(tmp_path: Path) -> None:
    (tmp_path / rows.RESULTS).write_text("{}\n")
    with pytest.raises(Mistake, match="line 1"):
        rows.read(tmp_path)


def test_table_shows_failures_with_their_cause() -> None:
    line = ladder("P1", 2, 1)
    text = rows.table([*line[:-1], fail(line[-1], cause="tangle")])
    assert "cook, variant A" in text and "failed: tangle" in text and "n=8" in text


def test_table_hides_the_error_of_a_run_that_did_not_finish() -> None:
    """What was sampled before the end is no error of the whole run."""
    row = ladder("P1", 2, 1)[0] | {"status": "failed", "cause": "cfl"}
    assert row["error"]["uy"] > 0 and rows.cells(row)[4] == ""


# --- ladders and sweeps -----------------------------------------------------------------------------------------------
def test_every_ladder_has_a_folder_and_a_line_of_its_own() -> None:
    every = [one for group in LADDERS.values() for one in group]
    assert len({one.folder for one in every}) == len(every)
    assert len({(one.scene, str(one.scene_knobs), one.label) for one in every}) == len(every)
    assert {one.method for one in SAMPLE} == {"fem", "mpm-linear", "mpm-cpdi", "pfem"}


def test_default_ladders_know_their_methods() -> None:
    assert [one.method for one in default_ladders("beam_drop", ["mpm-linear"])] == ["mpm-linear"]
    assert default_ladders("slope", ["mpm-linear"])[0].runs[0] == {"n": 4}
    with pytest.raises(Mistake, match="did you mean 'fem'"):
        default_ladders("cook", ["fme"])


def behave(behaviour: str) -> Ladder:
    return Ladder("cook", "fem", behaviour, (2, 4, 8), method_knobs={"behaviour": behaviour})


def test_sweep_survives_a_worker_that_is_killed(worker: None, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    found = sweep.run([behave("die"), behave("work")], tmp_path, repeats=2)
    assert [(row["label"], row["status"]) for row in found] == [("die", "ok"), ("die", "failed")] + [("work", "ok")] * 3
    assert found[1]["message"] == "worker died with signal 9 (SIGKILL)" and found[1]["knobs"]["n"] == 4
    assert rows.read(tmp_path) == found
    for row in found:
        assert row["status"] == "failed" or Result.load(tmp_path / row["run"]).error == row["error"]
    assert found[2]["repeats"] == 2 and found[2]["vary"] == "n" and found[2]["machine"]
    assert capsys.readouterr().out == ""  # stdout is the answer's: progress goes to stderr


def test_sweep_ends_a_run_that_takes_too_long(worker: None, tmp_path: Path) -> None:
    found = sweep.run([behave("sleep")], tmp_path, timeout=5)
    assert [row["status"] for row in found] == ["ok", "failed"] and found[1]["cause"] == "timeout"


def test_what_a_worker_calls_a_mistake_is_a_refusal_and_the_rest_goes_on(worker: None, tmp_path: Path) -> None:
    found = sweep.run([behave("mistake"), behave("work")], tmp_path)
    assert [row["status"] for row in found] == ["refused"] + ["ok"] * 3
    assert found[0]["message"] == "unknown knob 'behaviour': did you mean 'n'?"


def test_comparison_that_can_run_nothing_is_a_mistake(
    worker: None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(LADDERS, "cook", [behave("mistake")])
    with pytest.raises(Mistake, match="nothing could be run: unknown knob 'behaviour'"):
        sweep.compare(["cook"], None, tmp_path)
    assert "refused: unknown knob" in capsys.readouterr().out
    with pytest.raises(Mistake, match="did you mean 'cook'"):
        sweep.compare(["cok"], None, tmp_path)


def test_comparison_prints_the_table_and_writes_the_report(
    worker: None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(LADDERS, "cook", [behave("work")])
    assert len(sweep.compare(["cook"], ["fem"], tmp_path)) == 3
    assert "n=8" in capsys.readouterr().out and (tmp_path / "report.html").exists()


def test_interrupted_sweep_keeps_its_rows(worker: None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    keep = rows.append

    def append_and_interrupt(folder: Path, row: rows.Row) -> None:
        keep(folder, row)
        if row["knobs"]["n"] == 4:
            raise KeyboardInterrupt

    monkeypatch.setattr(rows, "append", append_and_interrupt)
    sweep.run([behave("work")], tmp_path)
    assert [row["knobs"]["n"] for row in rows.read(tmp_path)] == [2, 4]


# --- charts -----------------------------------------------------------------------------------------------------------
def words_of(figure: Any) -> str:
    legends = [text.get_text() for legend in figure.legends for text in legend.get_texts()]
    return "\n".join([text.get_text() for axes in figure.axes for text in axes.texts] + legends)


def test_refused_runs_have_no_line_in_a_chart() -> None:
    found = ladder("P1", 2, 1) + [fail(ladder("CLE", 2, 1, (2,))[0], status="refused", message="no")]
    words = words_of(chart.work_precision(found, "uy", chart.styles(["P1", "CLE"])))
    assert "P1" in words and "CLE" not in words


def drawn(found: list[rows.Row], measure: str = "uy") -> Any:
    return chart.work_precision(found, measure, chart.styles(map(rows.label, found)))


def test_failures_are_drawn_with_their_cause(tmp_path: Path) -> None:
    line, other = ladder("P1", 2, 1), ladder("MPM", 1, 1, method="mpm-linear")
    line[-1] = fail(line[-1], cause="tangle")
    other[-1] = fail(other[-1], cost={}, size={}, message="worker died with signal 9 (SIGKILL)")
    figure = drawn(line + other)
    words = words_of(figure)
    assert "P1 n=16: tangle" in words and "MPM n=16: worker died with signal 9 (SIGKILL)" in words
    for axes in figure.axes:
        assert sum(marks.get_marker() == "x" for marks in axes.lines) == 2
    path = chart.save(figure, tmp_path / "chart")
    assert path.with_suffix(".png").stat().st_size > 10_000
    assert chart.inline(path).startswith("<svg") and "http://www.w3.org/1999/xlink" in chart.inline(path)


def test_order_is_claimed_against_exact_references_only() -> None:
    line = ladder("P2", 2, 1)
    assert "order 2.0 in h" in words_of(drawn(line))
    assert "does not converge" in words_of(drawn(ladder("MPM", -0.5, 0.01)))
    band = {"uy": {"value": None, "lower": 23.0, "upper": 24.0, "kind": "bracket", "source": "made up"}}
    figure = drawn([row | {"reference": band} for row in line])
    assert "order" not in words_of(figure) and figure.axes[0].get_yscale() == "linear"
    unknown = {"uy": {"value": None, "kind": "cross-method", "source": "none known"}}
    assert drawn([row | {"reference": unknown} for row in line]).axes[0].get_yscale() == "linear"


def test_lines_differ_in_colour_and_marker() -> None:
    looks = chart.styles(map(str, range(56)))
    assert len({(look["color"], look["marker"]) for look in looks.values()}) == 56


def test_overhead_floor_is_where_refining_is_free() -> None:
    line = ladder("P1", 2, 1)
    assert chart.overhead({"P1": line}) is None  # the CPU time grows like the dofs
    line[0]["cost"] = {"cpu_s": 0.015}  # the next has four times the dofs and 0.016 s
    assert chart.overhead({"P1": line}) == 0.015


# --- recommendations --------------------------------------------------------------------------------------------------
def test_recommended_cost_is_interpolated_on_the_power_law() -> None:
    # error = n**-2 = 1e-3 / cost exactly, so that tol / 1.5 is met at the cost 1.5e-3 / tol
    choice = recommend.recommend(ladder("P2", 2, 1), "cook", 0.03)[0]
    assert choice.cost == pytest.approx(1.5e-3 / 0.03, rel=1e-12)
    assert choice.row["knobs"]["n"] == 8 and choice.below is not None and choice.below["knobs"]["n"] == 4


def test_cheapest_variant_is_first_and_nothing_is_extrapolated() -> None:
    found = ladder("P1", 1, 1) + ladder("P2", 2, 1)
    assert [choice.label for choice in recommend.recommend(found, "cook", 0.1)] == ["P2", "P1"]
    assert recommend.recommend(found, "cook", 1e-3) == []
    coarse = recommend.recommend(found, "cook", 10.0)[0]
    assert coarse.below is None and coarse.cost == 1e-3 * 4  # not below the cheapest run


def test_line_that_meets_the_tolerance_by_luck_is_not_recommended() -> None:
    line = ladder("MPM", -1, 0.01)  # the error grows: 2 %, 4 %, 8 %, 16 %
    assert recommend.recommend(line, "cook", 0.05) == []


def test_recommendation_counts_the_worst_measure_and_finished_runs_only() -> None:
    line = ladder("P2", 2, 1)
    for row in line:
        row["error"] = {**row["error"], "base_stress": 0.5}
    assert recommend.recommend(line, "cook", 0.1) == []
    assert recommend.recommend([fail(row) for row in ladder("P2", 2, 1)], "cook", 0.5) == []


def test_answer_names_the_run_or_the_best_there_is(tmp_path: Path) -> None:
    for row in ladder("P1", 1, 1) + ladder("P2", 2, 1):
        rows.append(tmp_path, row)
    assert "geofem run cook --method fem --set variant=A --set n=8" in recommend.answer("cook", 0.03, "cpu", tmp_path)
    assert "no method reaches 0.0001" in recommend.answer("cook", 1e-4, "dofs", tmp_path)
    assert "best is P2, n=16" in recommend.answer("cook", 1e-4, "dofs", tmp_path)
    for scene, tol, budget in (("slope", 0.1, "cpu"), ("cook", 0.0, "cpu"), ("cook", 0.1, "cpus")):
        with pytest.raises(Mistake):
            recommend.answer(scene, tol, budget, tmp_path)


# --- maps -------------------------------------------------------------------------------------------------------------
MAP = Map(
    name="made_up",
    title="Made up",
    scene="cook",
    measure="u",
    variants=(
        Variant("locks", "fem", {"n": 100, "locks": 1e-4}),
        Variant("dies", "fem", {"n": 100, "edge": True}),
        Variant("works", "fem", {"n": 100}),
        Variant("never works", "fem", {"n": 1}),
    ),
    knob="distance",
    axis="distance",
    safe=1.0,
    harsh=1e-6,
    threshold=0.1,
)


def test_bisection_finds_the_boundary(worker: None, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    lines = {line.label: line for line in stability.survey(MAP, tmp_path)}
    # each bisection halves the bracket of two decades: half of 2 / 2**4 decades is left on either side
    left = 0.5 * 2 / 2**MAP.bisections
    exact = 1e-4 / (MAP.threshold - 1e-4)  # where n**-2 + locks / distance is the threshold
    assert lines["locks"].boundary is not None and abs(math.log10(lines["locks"].boundary / exact)) <= left
    assert lines["dies"].boundary is not None and abs(math.log10(lines["dies"].boundary / 1e-3)) <= left
    assert lines["works"].boundary is None and lines["never works"].boundary == MAP.safe
    causes = {point.cause for point in lines["dies"].points if point.x < 1e-3}
    assert causes == {"worker died with signal 9 (SIGKILL)"}
    assert all(point.error is not None for point in lines["locks"].points)  # a death next door costs nothing
    words = "\n".join(text.get_text() for text in stability.draw(MAP, list(lines.values())).axes[0].texts)
    assert "× worker died" in words and "all along this axis" in stability.table(MAP, list(lines.values()))


def test_own_reference_of_a_map_replaces_the_scenes(worker: None, tmp_path: Path) -> None:
    this = Map("made_up", "", "cook", "u", (Variant("coarse", "fem", {"n": 2}),), "distance", "", 1.0, 0.1, 0.1,
               reference=Variant("fine", "fem", {"n": 10}), coarse=2, bisections=0)  # fmt: skip
    (line,) = stability.survey(this, tmp_path)
    assert line.points[0].error == pytest.approx((1 / 4 - 1 / 100) / (1 + 1 / 100), rel=1e-12)


def test_run_along_the_axis_tells_the_boundary_itself(worker: None, tmp_path: Path) -> None:
    variants = (Variant("breaks", "fem", {"n": 100, "breaks": 2.7}), Variant("holds", "fem", {"n": 100}))
    this = Map("made_up", "", "cook", "u", variants, "distance", "distance", 1.0, 5.0, 0.1, scale=Scale("linear"),
               along="distance", coarse=5)  # fmt: skip
    breaks, holds = stability.survey(this, tmp_path)
    assert [point.x for point in breaks.points] == [1, 2, 3, 4, 5], "no bisection"
    assert breaks.boundary == 2.7 and holds.boundary is None
    assert {(point.cause, point.at) for point in breaks.points[2:]} == {("fracture", 2.7)}
    assert stability.edges(breaks, this) == [1, 1.5, 2.7, 3.5, 4.5, 5], "the field of failure begins where the run ended"
    axes = stability.draw(this, [breaks, holds]).axes[0]
    assert axes.get_xscale() == "linear" and "× fracture" in {text.get_text() for text in axes.texts}


def test_worst_of_several_cases_counts(worker: None, tmp_path: Path) -> None:
    cases = [{"locks": locks} for locks in (0.0, 1e-3, 1e-4)]
    this = Map("made_up", "", "cook", "u", (Variant("fem", "fem", {"n": 10}),), "distance", "", 1.0, 0.01, 1.0,
               cases=cases, coarse=2, bisections=0)  # fmt: skip
    (line,) = stability.survey(this, tmp_path)
    assert [point.error for point in line.points] == pytest.approx([0.01 + 1e-3, 0.01 + 0.1])
    assert len(rows.read(tmp_path)) == 6
    died = [{"breaks": 1e9}, {"breaks": 0.5}]
    (line,) = stability.survey(replace(this, cases=died), tmp_path)
    assert line.points[0].cause == "fracture" and line.boundary == this.safe, "a run that dies is worse than any error"


def test_one_place_on_the_axis_may_set_several_knobs(worker: None, tmp_path: Path) -> None:
    this = Map("made_up", "", "cook", "u", (Variant("fem", "fem"),), "n", "cells", 4, 16, 1.0,
               value=lambda x: {"n": round(x), "locks": 1 / x}, coarse=2, bisections=0)  # fmt: skip
    (line,) = stability.survey(this, tmp_path)
    assert [point.error for point in line.points] == pytest.approx([1 / 16 + 1 / 4, 1 / 256 + 1 / 16])


def test_scales_of_maps() -> None:
    log, linear = Scale(), Scale("linear")
    assert log.spread(1, 100, 3) == pytest.approx([1, 10, 100]) and linear.spread(1, 5, 3) == [1, 3, 5]
    assert log.middle(1, 100) == pytest.approx(10) and linear.middle(1, 5) == 3
    assert log.way(1, math.e) == pytest.approx(1) and linear.way(1, 5) == 4


@pytest.mark.parametrize("name", MAPS)
def test_maps_name_knobs_that_exist(name: str) -> None:
    """Knobs of the scene and of the method, as the runner would check them; an analysis has its own."""
    this = MAPS[name]
    labels = [variant.label for variant in this.variants]
    assert len(set(labels)) == len(labels)
    for variant in this.variants:
        if not this.analysis:
            known = set(inspect.signature(scenes.get(this.scene)).parameters)
            known |= set(inspect.signature(methods.get(variant.method).build).parameters)
            given = {*this.scene_knobs, *variant.knobs, *this.knobs(this.safe), *(key for case in this.cases for key in case)}
            assert given <= known


def test_locking_map_varies_the_volume_and_not_the_shear() -> None:
    """mu = E / (2 + 2 nu) is the variant's for every nu of the map, to rounding; only the variant's own nu has a reference."""

    def mu(scene: Scene) -> float:
        E, nu = (scene.regions[0].material.parameters[name] for name in ("E", "nu"))
        return E / (2 + 2 * nu)

    this = MAPS["locking"]
    own = cook.scene(variant="C")
    for x in (this.safe, this.harsh):
        made = cook.scene(**this.scene_knobs, nu=this.value(x))
        assert mu(made) == pytest.approx(mu(own), rel=1e-14)
        assert made.measures[0].reference is None
    assert cook.scene(variant="C", nu=0.4999).measures[0].reference == own.measures[0].reference is not None


def test_maps_are_reachable_by_name() -> None:
    assert set(MAPS) == {this.name for this in MAPS.values()} and "locking" in MAPS
    with pytest.raises(Mistake, match="did you mean 'locking'"):
        stability.run(["loking"], Path("nowhere"))


# --- no dolfinx -------------------------------------------------------------------------------------------------------
def test_study_never_loads_dolfinx() -> None:
    load = "import geofem.study.sweep, geofem.study.stability, geofem.study.recommend"
    code = f"import json, sys; {load}; print(json.dumps(list(sys.modules)))"
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=Path(__file__).parents[1]
    )
    assert not {"dolfinx", "dolfinx_solver", "petsc4py", "pyvista", "h5py", "numba"} & set(json.loads(done.stdout))
