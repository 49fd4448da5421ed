"""Where a training run that could not push in the end is refused: when it starts."""

from lerobot.configs import PreTrainedConfig
from lerobot.optim import OptimizerConfig

from lerobot_act_chunking.hub.preflight import check_push


class ChecksPush(PreTrainedConfig):
    """Mixin of policy configurations: a fresh run of ``lerobot-train`` starts with `check_push`.

    LeRobot has no hook for the start of a run. What comes nearest is its question for the optimiser:
    ``TrainPipelineConfig.validate`` asks it once, in a fresh run only, before data or weights are read;
    resuming, evaluation, recording and rollouts never do. So the check is here, and the optimiser that a
    policy trains with is `training_optimizer`, which asks nobody.
    """

    def training_optimizer(self) -> OptimizerConfig:
        """The optimiser of a fresh run."""
        raise NotImplementedError

    def get_optimizer_preset(self) -> OptimizerConfig:
        """`training_optimizer`, after `check_push`: asks the real Hub who is logged in, unless offline.

        Raises:
            ConfigurationError: naming the ways out, if the run would push and nothing could take the push.
        """
        check_push(self)
        return self.training_optimizer()
