"""FetchReach: straight to the target."""

from lerobot_act_chunking.envs.robotics.experts.law import STILL, Move, Seen, Style, toward, with_fingers


def reach(seen: Seen, style: Style) -> Move:
    """Go to the target and stay."""
    return Move(with_fingers(toward(seen["desired_goal"], seen, style), STILL))
