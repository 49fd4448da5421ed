"""Robots that LeRobot can make, by the words of its ``--robot`` options, and what they feel and do."""

import pkgutil
from collections.abc import Mapping, Sequence
from contextlib import suppress
from importlib import import_module
from typing import Any

import draccus
import lerobot.cameras
import lerobot.robots
from lerobot.robots import RobotConfig, make_robot_from_config
from lerobot.utils.constants import ACTION, OBS_STR
from lerobot.utils.feature_utils import hw_to_dataset_features
from lerobot.utils.import_utils import register_third_party_plugins

from lerobot_act_chunking.errors import ConfigurationError, unknown_choice

READ = (".pos", ".vel")  # what lerobot-rollout lets policies see and do


def make_robot(given: Sequence[str]) -> Any:
    """The robot of ``type=...`` and of values of its configuration's fields; it is not connected.

    Raises:
        ConfigurationError: no type, an unknown one, or a field or a value that it does not take.
    """
    types = [each.partition("=")[2] for each in given if each.startswith("type=")]
    if not types:
        raise ConfigurationError(f"--robot.{given[0]} is of which robot? Give --robot.type as well")
    _register()
    if types[-1] not in RobotConfig.get_known_choices():
        raise unknown_choice("robot type", types[-1], sorted(RobotConfig.get_known_choices()))
    fields = [f"--{each}" for each in given if not each.startswith("type=")]
    try:
        config = draccus.parse(RobotConfig.get_choice_class(types[-1]), args=fields)
        return make_robot_from_config(config)
    except (Exception, SystemExit) as error:  # whatever draccus and the robot's library come upon
        raise ConfigurationError(f"--robot.type={types[-1]} cannot be made: {error!r}") from error


def robot_features(robot: Any) -> Mapping[str, Any]:
    """What a dataset recorded with the robot would have: the features that lerobot-rollout knows."""
    seen, done = (
        {key: each for key, each in hardware.items() if isinstance(each, tuple) or key.endswith(READ)}
        for hardware in (robot.observation_features, robot.action_features)
    )
    return hw_to_dataset_features(seen, OBS_STR) | hw_to_dataset_features(done, ACTION)


def _register() -> None:
    """Import LeRobot's robots and cameras, as far as their libraries are here, and those of plug-ins."""
    for package in (lerobot.robots, lerobot.cameras):
        for module in pkgutil.iter_modules(package.__path__, f"{package.__name__}."):
            if module.ispkg:
                with suppress(ImportError):
                    import_module(module.name)
    register_third_party_plugins()
