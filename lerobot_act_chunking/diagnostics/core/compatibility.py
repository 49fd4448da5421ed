"""Whether a policy fits an environment or a dataset: keys, sizes and control rate, checked in one place."""

from collections.abc import Mapping, Sequence
from typing import Any

from lerobot.utils.constants import ACTION

from lerobot_act_chunking.errors import FeatureError

Shape = Sequence[int]
OTHER_DATASET = "give a dataset of the same robot, recorded as the one it was trained on"


def check_features(config: Any, present: Mapping[str, Shape], where: str, fix: str) -> None:
    """Refuse to let a policy see or do what there is not.

    Images are compared by key alone: policies resize, and their channels come first or last.

    Args:
        config: the policy's, with ``input_features`` and ``action_feature``.
        present: shapes of all observations and of the action, by LeRobot's keys.
        where: the name of the environment or dataset.
        fix: the way out.

    Raises:
        FeatureError: naming the key, both sizes and the way out.
    """
    wanted = {key: tuple(feature.shape) for key, feature in (config.input_features or {}).items()}
    if config.action_feature is not None:
        wanted[ACTION] = tuple(config.action_feature.shape)
    for key, shape in wanted.items():
        if key not in present:
            raise FeatureError(f"the policy needs {key!r}, but {where} has {', '.join(present)}: {fix}")
        there = tuple(present[key])
        if len(shape) == 1 and there != shape:
            raise FeatureError(
                f"the policy was trained with {_size(shape)} of {key!r}, {where} has {_size(there)}: {fix}"
            )


def check_rate(policy_fps: float | None, fps: float, where: str, fix: str) -> None:
    """Refuse a policy that was trained at another rate, as far as that is known.

    Raises:
        FeatureError: naming both rates.
    """
    if policy_fps is not None and abs(policy_fps - fps) > 0.01 * fps:
        raise FeatureError(
            f"the policy was trained at {policy_fps:g} control steps a second, {where} runs at {fps:g}: {fix}"
        )


def _size(shape: Shape) -> str:
    return f"{shape[0]} numbers" if len(shape) == 1 else f"shape {tuple(shape)}"
