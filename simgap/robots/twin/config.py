"""Hyperparameters of a twin."""

from dataclasses import dataclass

from simgap.residual.config import check
from simgap.types import ConfigError


@dataclass(frozen=True)
class Config:
    """Of the fit to windows of many rows; the fit to single rows has `simgap.residual.config.Config`.

    horizon: rows of a window; stride: rows between the starts of windows. training_steps, evaluate_every, batch_size
    [windows a step]: of the fit, by Adam with learning rates that fall to 0. simulator_learning_rate: of the parameters
    [half their plausible ranges] and of the ages [s]. learning_rate, weight_decay, hidden_layer_sizes: of the network
    of the residual. heldout_share: of the sessions, to choose the number of steps by. folds: of the cross-validation
    over sessions. replays: runs with recorded departures from every start, to measure their coverage.
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
        check(self)
        if self.folds < 2:
            raise ConfigError("folds is 1; sessions that are held out need at least 2.")
