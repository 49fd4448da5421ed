"""What is asked: which sources, and which episodes of checkpoints."""

from dataclasses import dataclass, field
from functools import partial

from act_chunking_runtime.number_checks import check_at_least
from lerobot_act_chunking.diagnostics.core.environments import EnvironmentSpec, task_environment
from lerobot_act_chunking.errors import ConfigurationError


@dataclass(frozen=True)
class EvaluationSpec:
    """Which episodes a checkpoint is run for.

    Raises:
        ConfigurationError: too few episodes or environments.
    """

    environment: EnvironmentSpec = field(default_factory=partial(task_environment, "transfer_cube"))
    episodes: int = 50
    seed: int = 1000
    n_envs: int = 50

    def __post_init__(self) -> None:
        if self.episodes < 2:
            raise ConfigurationError(f"episodes={self.episodes}: smoothness needs at least 2")
        check_at_least(1, n_envs=self.n_envs)


@dataclass(frozen=True)
class Settings:
    """What to diagnose.

    Attributes:
        sources: folders or repo ids of checkpoints, folders of LeRobotDatasets; all are compared.
        evaluation: which episodes to run of checkpoints.
        replan_interval: control steps between the chunks behind the datasets' motion; None if it was not
            chunked.
    """

    sources: tuple[str, ...]
    evaluation: EvaluationSpec = field(default_factory=EvaluationSpec)
    replan_interval: int | None = None
