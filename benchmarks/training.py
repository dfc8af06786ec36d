"""Speed of training FSVGD and Sim-FSVGD at the sizes of params.yaml, against a training loop in Python.

    python -m benchmarks.training [--steps N] [--repeats R]

Ours is what `simgap.fsvgd.train` does between two reports: a scan over prepared measurement sets, then the validation
NLL. The baseline is the same model trained in the straightforward way: one compiled update per step, dispatched from
Python, on a minibatch gathered on the host and on fresh measurement points, the prior computed anew in every step.
Networks, SVGD direction, noise and optimiser are the project's own in both; one update of both is compared first.
All cases take turns within every repeat. Prints a table and writes benchmarks/training.json.
"""

import argparse
import dataclasses
import json
import statistics
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import jax

from benchmarks.timing import Case, machine, measure, ratio, seconds, side_by_side, spread
from benchmarks.training_loop import baseline, differences
from benchmarks.training_problem import (
    SAMPLE_SIZE,
    Cell,
    batched,
    make_problem,
    prepare_cell,
    synthetic_transitions,
    train_cell,
    with_noise,
)
from simgap import identify
from simgap.noise import FAMILIES
from simgap.simulators.spot import Spot
from tasks.params import Params, load_params
from tasks.train import grid, steps_at_most

ROOT = Path(__file__).parents[1]
OUTPUT = ROOT / "benchmarks" / "training.json"
TRAININGS = {"in full": 200_000, "stopped early": 15_000}
"""Steps of a training, over which the preparation of the prior is spread."""
TOLERANCE = 1e-4
"""Relative difference allowed between one update of ours and of the baseline; without FSVGD's prior it is 8e-4."""


def bnn_cases(cells: Sequence[Cell], params: Params, steps: int) -> dict[str, Case]:
    """Everything measured of one model; ours and the baseline are neighbours in time."""
    workers, seeds = params.train.workers, len(params.train.seeds)
    cases = {
        "ours": Case(partial(train_cell, cells[0], steps), 1),
        "baseline": Case(baseline(cells[0], steps), 1),
        "seeds in turn": Case(lambda: [train_cell(cell, steps) for cell in cells[:seeds]], seeds),
        "seeds batched": Case(batched(cells[:seeds], steps), seeds),
    }
    for noise in params.train.noises:
        jobs = [partial(train_cell, with_noise(cell, FAMILIES[noise]), steps) for cell in cells[:workers]]
        cases[f"threads, {noise}"] = Case(partial(side_by_side, jobs), workers)
    return cases


def benchmark_bnn(model: str, params: Params, steps: int, repeats: int) -> dict[str, Any]:
    """All figures of FSVGD or Sim-FSVGD."""
    problem, cells, preparation = make_problem(model, params), [], []
    for seed in range(max(params.train.workers, len(params.train.seeds))):
        preparation.append(seconds(lambda seed=seed: cells.append(prepare_cell(problem, seed))))
    found = differences(cells[0])
    if not max(found.values()) < TOLERANCE:
        raise AssertionError(f"{model}: ours and the baseline differ by {found}; at most {TOLERANCE} is allowed.")
    ms = measure(bnn_cases(cells, params, steps), steps, repeats)
    amortised = {name: 1e3 * statistics.median(preparation) / total for name, total in TRAININGS.items()}
    whole = {
        name: ratio({**ms, "whole": [t + extra for t in ms["ours"]]}, "whole", "baseline")
        for name, extra in amortised.items()
    }
    return {
        "relative_difference": found,
        "ms_per_model_and_step": {name: spread(values) for name, values in ms.items()},
        "preparation_s": spread(preparation),
        "preparation_ms_per_step": amortised,
        "ratio_ours_to_baseline": ratio(ms, "ours", "baseline"),
        "ratio_ours_with_preparation_to_baseline": whole,
        "ratio_seeds_batched_to_in_turn": ratio(ms, "seeds batched", "seeds in turn"),
    }


def benchmark_sim_model(params: Params, steps: int, repeats: int) -> dict[str, Any]:
    """SIM-MODEL, for the whole grid's time only: full batches, of the grid's mean N."""
    spot, workers = Spot(1 / params.transitions.nominal_rate_hz), params.train.workers
    data = synthetic_transitions(jax.random.key(0), round(statistics.mean(params.train.sample_sizes)), spot)
    config = dataclasses.replace(params.train.sim_model, training_steps=steps, evaluate_every=steps)
    cases = {}
    for noise in params.train.noises:
        fit = partial(identify.identify, spot, data, config, FAMILIES[noise], no_report)
        cases[f"threads, {noise}"] = Case(partial(side_by_side, [fit] * workers), workers)
    ms = measure(cases, steps, repeats)
    return {"ms_per_model_and_step": {name: spread(values) for name, values in ms.items()}}


def no_report(_step: int, _metrics: dict[str, float]) -> None:
    """A report that nobody reads."""


def grid_minutes(params: Params, figures: Mapping[str, Any]) -> dict[str, float]:
    """Minutes for all cells by model, no cell stopped early, `workers` side by side.

    The preparations are added as if only one at a time could run: an upper bound.
    """
    minutes: dict[str, float] = dict.fromkeys(params.train.models, 0.0)
    for cell in grid(params.train):
        measured = figures[cell.method]  # with a diagnosed simulator it steps like its twin
        ms = measured["ms_per_model_and_step"][f"threads, {cell.noise}"]["median"]
        preparation = measured.get("preparation_s", {"median": 0.0})["median"]
        minutes[cell.model] += (ms / 1e3 * steps_at_most(cell, params.train) + preparation) / 60
    return {**minutes, "all": sum(minutes.values())}


def table(results: Mapping[str, Any]) -> str:
    """All figures, a line each: median, then least and greatest."""
    lines = [f"{'':58}{'median':>10}{'min':>10}{'max':>10}"]

    def row(name: str, values: Mapping[str, float]) -> None:
        lines.append(f"{name:58}" + "".join(f"{values[k]:10.3f}" for k in ("median", "min", "max")))

    for model, figures in results["models"].items():
        for case, values in figures["ms_per_model_and_step"].items():
            row(f"{model}: {case} [ms per model and step]", values)
        if "preparation_s" not in figures:
            continue
        row(f"{model}: preparation [s]", figures["preparation_s"])
        for name, value in figures["preparation_ms_per_step"].items():
            lines.append(f"{f'{model}: preparation, {name} [ms per step]':58}{value:10.3f}")
        row(f"{model}: ours / baseline", figures["ratio_ours_to_baseline"])
        for name, values in figures["ratio_ours_with_preparation_to_baseline"].items():
            row(f"{model}: ours with preparation, {name} / baseline", values)
        row(f"{model}: seeds batched / in turn", figures["ratio_seeds_batched_to_in_turn"])
    for model, minutes in results["grid_minutes"].items():
        lines.append(f"{f'whole grid, {model} [min]':58}{minutes:10.1f}")
    return "\n".join(lines)


def count(text: str) -> int:
    """An argument that must be a whole number above 0."""
    if (value := int(text)) < 1:
        raise argparse.ArgumentTypeError(f"{value} is given; it must be at least 1.")
    return value


def main() -> None:
    """Measure, print, write."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.training", description="Speed of training.")
    parser.add_argument("--steps", type=count, default=500, help="training steps of one measurement")
    parser.add_argument("--repeats", type=count, default=7, help="measurements of each case")
    options = parser.parse_args()
    params = load_params(ROOT / "params.yaml")
    results: dict[str, Any] = {"machine": machine(), "steps": options.steps, "repeats": options.repeats}
    models = {"sim_model": benchmark_sim_model(params, options.steps, options.repeats)}
    for model in ("fsvgd", "sim_fsvgd"):
        models[model] = benchmark_bnn(model, params, options.steps, options.repeats)
    results |= {
        "sample_size": SAMPLE_SIZE,
        "trainings": TRAININGS,
        "workers": params.train.workers,
        "models": models,
        "grid_minutes": grid_minutes(params, models),
    }
    print(table(results))
    OUTPUT.write_text(json.dumps(results, indent=2) + "\n")


if __name__ == "__main__":
    main()
