"""One environment by the name of its task."""

from typing import Any

import gymnasium as gym

from lerobot_act_chunking.envs.registration import GYM_IDS, SO_ARM_IDS, THREE_GATES_ID, robotics_id
from lerobot_act_chunking.envs.robotics.tasks import TASKS as ROBOTICS_TASKS
from lerobot_act_chunking.errors import unknown_choice


def make_env(task: str = "transfer_cube", **options: Any) -> gym.Env:
    """Make a simulated environment, ready for ``reset`` and ``step``.

    Observations are a dictionary: ``agent_pos`` (S,), ``environment_state`` (E,) and, with ``obs_type``
    ``pixels`` or ``pixels_state``, ``pixels`` ``{camera: uint8 (height, width, 3)}``. ``info["is_success"]``
    says whether the task is done.

    Args:
        task: ``transfer_cube``, ``insertion``, ``transfer_modes`` or ``language_transfer`` (ALOHA),
            ``pick_place``, ``stack`` or ``two_ways`` (SO-101), ``three_gates``, or of gymnasium-robotics, as
            ``FetchPush-v4``.
        options: fields of `AlohaSimOptions`, `SoArmOptions`, `ThreeGatesOptions` or `RoboticsOptions`, such
            as ``obs_type`` and ``cameras``.

    Raises:
        ConfigurationError: an unknown task, or an option that cannot work.
    """
    fetch = {name: robotics_id(name) for name in ROBOTICS_TASKS}
    ids = {**GYM_IDS, **SO_ARM_IDS, "three_gates": THREE_GATES_ID, **fetch}
    if task not in ids:
        raise unknown_choice("task", task, ids)
    return gym.make(ids[task], disable_env_checker=True, **options)
