"""Hyperparameters of the model with a residual."""

from dataclasses import dataclass
from typing import Protocol

from simgap.types import ConfigError


class Training(Protocol):
    """Of the hyperparameters of a fit with held-out sessions, those whose relations are checked."""

    @property
    def heldout_share(self) -> float: ...
    @property
    def training_steps(self) -> int: ...
    @property
    def evaluate_every(self) -> int: ...


def check(config: Training) -> None:
    """Raise ConfigError unless all values are above 0 and those of the training fit together."""
    for name, value in vars(config).items():
        if not value or min(value if isinstance(value, tuple) else (value,)) <= 0:
            raise ConfigError(f"{name} is {value}; it must be above 0.")
    if config.heldout_share >= 1:
        raise ConfigError(f"heldout_share is {config.heldout_share}; it must be below 1.")
    if config.evaluate_every > config.training_steps:
        raise ConfigError(f"evaluate_every is {config.evaluate_every}; it must be at most training_steps.")


@dataclass(frozen=True)
class Config:
    """Beside those of the networks, the batch and the kernel, which are `fsvgd.Config`'s.

    simulator_steps, simulator_learning_rate, simulator_batch: of the fit of the simulator, by Adam on so many rows a
    step. durations: number Q of equally likely durations of a row. outputscales [units of what the simulator misses]
    and lengthscales [features' standard deviations]: of the residual's prior, of which one pair is chosen by the
    rows of whole sessions, a share `heldout_share` of the N, that are held out for it. training_steps, evaluate_every,
    patience: of the residual, whose training ends after `patience` steps without a better validation. paces [steps a
    row] to choose from for predictions over `horizon` rows.
    """

    simulator_steps: int
    simulator_learning_rate: float
    simulator_batch: int
    durations: int
    outputscales: tuple[float, ...]
    lengthscales: tuple[float, ...]
    training_steps: int
    evaluate_every: int
    patience: int
    measurement_points: int
    heldout_share: float
    paces: tuple[float, ...]
    horizon: int

    def __post_init__(self) -> None:
        check(self)

    @property
    def scales(self) -> list[tuple[float, float]]:
        """Every (outputscale, lengthscale) to choose from."""
        return [(nu, length) for nu in self.outputscales for length in self.lengthscales]

    @property
    def all_steps(self) -> int:
        """Steps of the fit, of every choice and of the last training."""
        return self.simulator_steps + (len(self.scales) + 1) * self.training_steps
