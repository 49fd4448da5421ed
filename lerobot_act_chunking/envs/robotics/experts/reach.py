"""FetchReach: straight to the target."""

from lerobot_act_chunking.envs.robotics.experts.controller import (
    STILL,
    Move,
    Observation,
    Style,
    toward,
    with_fingers,
)


def reach(observation: Observation, style: Style) -> Move:
    """Go to the target and stay."""
    return Move(with_fingers(toward(observation["desired_goal"], observation, style), STILL))
