"""Which environment a policy acts in when a diagnosis lets it act: any that LeRobot can make."""

import logging
from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from difflib import get_close_matches
from typing import Any, get_type_hints

import draccus
from lerobot.configs.parser import PluginLoadError, load_plugin
from lerobot.envs.configs import EnvConfig
from lerobot.utils.constants import ACTION
from lerobot.utils.import_utils import register_third_party_plugins

from lerobot_act_chunking.data.dimension_names import dimension_names
from lerobot_act_chunking.diagnostics.core.compatibility import check_features, check_rate
from lerobot_act_chunking.diagnostics.core.success_keys import naming_success
from lerobot_act_chunking.diagnostics.core.training import dataset_features, read_training
from lerobot_act_chunking.envs.configuration_simulation import SimulationEnvConfig
from lerobot_act_chunking.errors import ActChunkingError, ConfigurationError, FeatureError, unknown_choice

logger = logging.getLogger(__name__)

OTHER_ROBOT = (
    "run it on the robot or task that it was trained for (--env.type, --env.task), or measure its "
    "recordings: act-chunking smoothness, resolution, codebook, latent and steps take a dataset's folder"
)
PERHAPS_A_LABEL = "unless one of the two is a mere label, run it on the task that it was trained for"
"""Environments need not run at the rate that their configuration states (huggingface/lerobot#3368)."""


@dataclass(frozen=True)
class EnvironmentSpec:
    """Which environment is asked for, in the words of LeRobot's ``--env``.

    Attributes:
        type: of the environment: LeRobot's own, an installed plug-in's, or one of ``packages``.
        arguments: fields of its configuration, as YAML would give them.
        packages: that register it when they are imported, as ``--env.discover_packages_path``.
        success_key: which member of ``info`` says that the episode has succeeded; None for LeRobot's.

    Raises:
        ConfigurationError: a package that cannot be imported, an unknown type, a field that it does not
            have, or a value that the field does not take.
    """

    type: str
    arguments: Mapping[str, Any] = field(default_factory=dict)
    packages: tuple[str, ...] = ()
    success_key: str | None = None

    def __post_init__(self) -> None:
        for package in self.packages:
            _import(package)
        if self.type not in EnvConfig.get_known_choices():
            register_third_party_plugins()
        types = EnvConfig.get_known_choices()
        if self.type not in types:
            ways = "or import the package that has it by --env.discover_packages_path"
            raise unknown_choice("environment type", self.type, [*sorted(types), ways])
        self.options()

    @property
    def name(self) -> str:
        """What reports call it: its task if one is asked for, else its type."""
        return str(self.arguments.get("task") or self.type)

    def options(self) -> dict[str, Any]:
        """The arguments as values of the fields' types.

        Raises:
            ConfigurationError: a field that is not there, or a value that it does not take.
        """
        config_class = EnvConfig.get_choice_class(self.type)
        hints = get_type_hints(config_class)
        names = [each.name for each in fields(config_class) if each.init]
        found = {}
        for name, value in self.arguments.items():
            if name not in names:
                raise ConfigurationError(f"{self.type} has no --env.{name}{_nearest(name, names)}")
            try:
                found[name] = draccus.decode(hints[name], value)
            except Exception as error:  # draccus raises what it comes upon
                reason = " ".join(str(error).split())
                raise ConfigurationError(
                    f"--env.{name} of {self.type} does not take {value!r}: {reason}"
                ) from error
        return found


def task_environment(task: str, success: str | None = None) -> EnvironmentSpec:
    """The environment that has a task of this name, if it is one of the `SimulationEnvConfig`.

    Args:
        task: its name, as ``insertion`` or ``FetchPush-v4``.
        success: its success rule; by default the environment's own.

    Raises:
        ConfigurationError: no such environment has it; lists all that there are.
    """
    register_third_party_plugins()
    types = {
        name: env_type
        for env_type, config_class in EnvConfig.get_known_choices().items()
        if issubclass(config_class, SimulationEnvConfig)
        for name in config_class.task_names
    }
    if task not in types:
        raise unknown_choice("task", task, [*types, "or any environment by --env.type"])
    rule = {} if success is None else {"success": success}
    return EnvironmentSpec(types[task], {"task": task, **rule})


def environment_of(config: Any, spec: EnvironmentSpec, checkpoint: str | None = None) -> EnvConfig:
    """The configuration of an environment for a policy, which must be one for this robot.

    What a `SimulationEnvConfig` observes follows from what the policy observes, except where ``spec`` says
    it. All other environments are taken as ``spec`` says.

    Args:
        config: the policy's.
        spec: which environment.
        checkpoint: folder or repo id of the policy, where its control rate may be known from; None for the
            rate that ``config`` has, if any.

    Raises:
        ConfigurationError: options that the environment refuses.
        FeatureError: a policy for another robot, or one for another control rate than that of a
            `SimulationEnvConfig`; with all others that is a warning.
    """
    env_config = _make_config(config, spec)
    where = f"the environment {spec.name}"
    _check_features(config, env_config, where)
    fps = getattr(config, "fps", None) if checkpoint is None else read_training(checkpoint, config).fps
    known = isinstance(env_config, SimulationEnvConfig)
    try:
        check_rate(fps, env_config.fps, where, OTHER_ROBOT if known else PERHAPS_A_LABEL)
    except FeatureError as error:
        if known:
            raise
        logger.warning("%s", error)
    return naming_success(env_config, spec.success_key)


def action_names(env_config: EnvConfig, n: int, checkpoint: str) -> tuple[str, ...]:
    """A name for each number of an action: the environment's, or those of the training data.

    Args:
        env_config: the environment's; ``action_names`` is its own names.
        n: how many numbers an action has.
        checkpoint: folder or repo id of the policy.
    """
    own = getattr(env_config, "action_names", ())
    if len(own) == n:
        return tuple(own)
    recorded = dataset_features(read_training(checkpoint).folder).get(ACTION, {})
    return dimension_names({"names": recorded.get("names"), "shape": (n,)})


def _import(package: str) -> None:
    try:
        load_plugin(package)
    except (PluginLoadError, AttributeError) as error:
        raise ConfigurationError(
            f"--env.discover_packages_path={package} cannot be imported: {error}; give a package that is "
            "installed or on PYTHONPATH (one that is a single file needs __path__ = [])"
        ) from error


def _nearest(name: str, names: list[str]) -> str:
    found = get_close_matches(name, names, n=1)
    guess = f"; did you mean --env.{found[0]}?" if found else "."
    return f"{guess} It has: {', '.join(names)}"


def _make_config(config: Any, spec: EnvironmentSpec) -> EnvConfig:
    make, options = EnvConfig.get_choice_class(spec.type), spec.options()
    if issubclass(make, SimulationEnvConfig):
        options = make.options_for(config, options)
    try:
        return make(**options)
    except ActChunkingError:
        raise
    except Exception as error:  # whatever other people's checks raise
        raise ConfigurationError(f"{spec.type} refuses its --env options: {error}") from error


def _check_features(config: Any, env_config: EnvConfig, where: str) -> None:
    """As far as can be told: an environment may say nothing, or rename what it observes by its processors."""
    if not env_config.features or any(each.steps for each in env_config.get_env_processors()):
        return
    keys = env_config.features_map
    shapes = {keys.get(key, key): feature.shape for key, feature in env_config.features.items()}
    check_features(config, shapes, where, OTHER_ROBOT)
