"""Speed of soft actor-critic at the sizes of params.yaml, against brax's and sbx's, side by side in the same run.

    python -m benchmarks.policies [--rounds R] [--environments FOLDER]

Everyone does the same work: batches of 64, 64-64 networks, observations of 24 and actions of 6 numbers, 1,024 gradient
updates to 1,024 environment steps of 64 environments. Ours learns in a model of Sim-FSVGD's shape; brax in an
environment of one multiplication; of sbx, whose environments are Python's, the updates alone are timed. Ours runs on
one thread, and as two policies on two threads; the others as they come, free to use every core. The cases take turns
within every round. Two rates are printed: updates per second, and per second of processor time, all threads' together,
which other work on the machine hardly disturbs. The rivals' pins conflict with the project's: each is installed with uv
into an environment of its own, below FOLDER (a temporary one unless given), which takes minutes. Prints a table, writes
benchmarks/policies.json.
"""

import argparse
import dataclasses
import json
import os
import platform
import statistics
import subprocess
import sys
import tempfile
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

import flows  # noqa: F401  # settles the threads of XLA, as for every stage
from simgap import networks
from simgap.models import BNN
from simgap.policies import learn
from simgap.policies.environment import LearntSpot, box
from simgap.recordings import Normalisation
from tasks.params import load_params

ROOT = Path(__file__).parents[1]
UV = Path(sys.executable).with_name("uv")
OUTPUT = ROOT / "benchmarks" / "policies.json"
CYCLES = 6
"""Of 1,024 updates, timed at once."""
RIVALS = {"brax": ["brax==0.10.5", "jax==0.4.38", "jaxlib==0.4.38"], "sbx": ["sbx-rl==0.28.0", "jax==0.10.2"]}

_BRAX = """
import time
import jax, jax.numpy as jnp
from brax.envs.base import Env, State
from brax.training.agents.sac import networks, train
from functools import partial

class Still(Env):
    observation_size, action_size, backend = 24, 6, "generalized"
    def reset(self, rng):
        obs = jax.random.normal(rng, (24,))
        return State(None, obs, jnp.zeros(()), jnp.zeros(()), {}, {})
    def step(self, state, action):
        return state.replace(obs=0.99 * state.obs, reward=-jnp.sum(action ** 2))

times = []
def progress(steps, _):
    times.append((steps, time.perf_counter(), time.process_time()))

steps = 2048 + 64 * 16 * CYCLES
train.train(Still(), num_timesteps=3 * steps, episode_length=120, num_envs=64, num_eval_envs=1, learning_rate=1e-4,
            discounting=0.99, batch_size=64, num_evals=4, tau=0.005, min_replay_size=2048, max_replay_size=50000,
            grad_updates_per_step=64, normalize_observations=True, progress_fn=progress,
            network_factory=partial(networks.make_sac_networks, hidden_layer_sizes=(64, 64)))
(first, start, used), (last, end, used_then) = times[-2:]
print((last - first) / (end - start), (last - first) / (used_then - used))  # an update for every environment step
"""

_SBX = """
import time
import gymnasium, numpy as np
from sbx import SAC

class Still(gymnasium.Env):
    observation_space = gymnasium.spaces.Box(-np.inf, np.inf, (24,), np.float32)
    action_space = gymnasium.spaces.Box(-1, 1, (6,), np.float32)
    def reset(self, seed=None, options=None):
        super().reset(seed=seed)
        return self.np_random.normal(size=24).astype(np.float32), {}
    def step(self, action):
        return self.np_random.normal(size=24).astype(np.float32), -float(np.sum(action ** 2)), False, False, {}

model = SAC("MlpPolicy", Still(), learning_rate=1e-4, batch_size=64, tau=0.005, gamma=0.99, buffer_size=50000,
            learning_starts=2048, train_freq=(1024, "step"), gradient_steps=1024, policy_kwargs={"net_arch": [64, 64]})
model.learn(2048 + 1024 * 2)
start, used = time.perf_counter(), time.process_time()
for _ in range(CYCLES):
    model.train(1024, 64)
print(1024 * CYCLES / (time.perf_counter() - start), 1024 * CYCLES / (time.process_time() - used))
"""


def install(rival: str, folder: Path) -> Path:
    """The Python of a rival's own environment."""
    python = folder / rival / "bin" / "python"
    if not python.exists():
        subprocess.run([UV, "venv", "--quiet", "--python", "3.11", folder / rival], check=True)
        subprocess.run([UV, "pip", "install", "--quiet", "--python", python, *RIVALS[rival]], check=True)
    return python


class Rate(NamedTuple):
    """Updates per second, and per second of processor time."""

    per_second: float
    per_core_second: float


def time_rival(python: Path, program: str) -> Rate:
    """The rates that a rival's program prints, in a process without this project's settings."""
    environment = {k: v for k, v in os.environ.items() if not k.startswith(("XLA", "JAX", "OPENBLAS"))}
    code = f"CYCLES = {CYCLES}\n{program}"
    done = subprocess.run([python, "-c", code], env=environment, capture_output=True, text=True, check=False)
    if done.returncode:
        raise RuntimeError(f"{python} failed; its last words:\n{done.stderr[-2000:]}")
    wall, core = done.stdout.split()[-2:]
    return Rate(float(wall), float(core))


class Ours:
    """Policies being learnt in a model of Sim-FSVGD's shape, as the stage `policy` does."""

    def __init__(self, count: int) -> None:
        params = load_params(ROOT / "params.yaml").policy
        keys = jax.random.split(jax.random.key(0), 3)
        x = jax.random.uniform(keys[0], (1000, 31), minval=-1.0)
        stats = Normalisation(jnp.zeros(31), jnp.ones(31), jnp.zeros(13), jnp.full(13, 0.01))
        particles = networks.init(keys[1], 5, (31, 64, 64, 64, 13))
        model = BNN(particles, jnp.full(13, 0.1), jnp.full(13, 3.0), stats)
        self._environment, self._sac = LearntSpot(model, box(x), params.environment), params.sac
        # What lies between two evaluations; the evaluation itself is small.
        steps = params.learning.prefill_steps * params.learning.environments + CYCLES * params.learning.cycle_steps
        self._config = dataclasses.replace(
            params.learning, environment_steps=steps, evaluations=1, evaluation_environments=1, plateau=0
        )
        self._states = [
            learn.init(jax.random.key(seed), self._environment, self._config, self._sac) for seed in range(count)
        ]
        self.time(1)  # compiled

    def time(self, threads: int) -> Rate:
        """Of so many policies, a thread each."""
        start, used = time.perf_counter(), time.process_time()
        with ThreadPoolExecutor(threads) as pool:
            self._states[:threads] = list(pool.map(self._advance, self._states[:threads]))
        updates = threads * CYCLES * self._config.updates
        return Rate(updates / (time.perf_counter() - start), updates / (time.process_time() - used))

    def _advance(self, state: learn.Training) -> learn.Training:
        state, _ = learn.advance(state, jnp.int32(0), self._environment, self._config, self._sac)
        return jax.block_until_ready(state)


def measure(rounds: int, folder: Path) -> dict[str, list[Rate]]:
    """The rates of updates, and of as many environment steps, of every case and round."""
    pythons = {rival: install(rival, folder) for rival in RIVALS}
    ours = Ours(2)
    found: dict[str, list[Rate]] = {}
    for _ in range(rounds):
        for name, rate in (
            ("ours, one thread", ours.time(1)),
            ("ours, two threads", ours.time(2)),
            ("brax 0.10.5", time_rival(pythons["brax"], _BRAX)),
            ("sbx 0.28", time_rival(pythons["sbx"], _SBX)),
        ):
            found.setdefault(name, []).append(rate)
            print(f"{name:20}{rate.per_second:10,.0f} updates/s{rate.per_core_second:10,.0f} / core s", flush=True)
    return found


def main() -> None:
    """Measure, print, write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--environments", type=Path, help="folder for the rivals' environments, kept")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as scratch:
        found = measure(arguments.rounds, arguments.environments or Path(scratch))
    summary: dict[str, Any] = {}
    for which in Rate._fields:
        rates = {name: [round(getattr(rate, which)) for rate in rates] for name, rates in found.items()}
        medians = {name: statistics.median(values) for name, values in rates.items()}
        faster = max(rate for name, rate in medians.items() if not name.startswith("ours"))
        summary[f"updates_{which}"] = medians
        summary[f"rounds_{which}"] = rates
        summary[f"ours / faster rival, {which}"] = round(medians["ours, two threads"] / faster, 2)
    summary |= {
        "jax": jax.__version__,
        "python": platform.python_version(),
        "cores": len(os.sched_getaffinity(0)),
    }
    OUTPUT.write_text(json.dumps(summary, indent=1) + "\n")
    print(json.dumps(summary, indent=1), file=sys.stdout)


if __name__ == "__main__":
    main()
