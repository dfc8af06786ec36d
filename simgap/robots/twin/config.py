"""Hyperparameters of a twin."""

from dataclasses import dataclass, fields

from simgap.types import ConfigError


@dataclass(frozen=True)
class Config:
    """Beside those of the fit to single rows, which are `simgap.residual.config.Config`'s.

    horizon: rows of a window that is predicted; stride: rows between starts of windows. training_steps,
    evaluate_every, batch_size [windows a step]: of the fit to windows, by Adam, the learning rates falling to 0.
    simulator_learning_rate: of the parameters, in half their plausible ranges, and of the ages [s]. learning_rate,
    weight_decay, hidden_layer_sizes: of the residual's network. heldout_share: of
    the sessions, that choose the number of steps. folds: of the cross-validation over sessions. replays: runs with
    recorded departures, from every start, that say whether these make up for what the model does not know.
    """

    horizon: int
    stride: int
    training_steps: int
    evaluate_every: int
    batch_size: int
    simulator_learning_rate: float
    learning_rate: float
    weight_decay: float
    hidden_layer_sizes: tuple[int, ...]
    heldout_share: float
    folds: int
    replays: int

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            if not value or min(value if isinstance(value, tuple) else (value,)) <= 0:
                raise ConfigError(f"{field.name} is {value}; it must be above 0.")
        if self.heldout_share >= 1:
            raise ConfigError(f"heldout_share is {self.heldout_share}; it must be below 1.")
        if self.evaluate_every > self.training_steps:
            raise ConfigError(f"evaluate_every is {self.evaluate_every}; it must be at most training_steps.")
        if self.folds < 2:
            raise ConfigError("folds is 1; sessions that are held out need at least 2.")
