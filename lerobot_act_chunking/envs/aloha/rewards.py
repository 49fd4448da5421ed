"""gym-aloha's rewards as functions of the touching geom pairs, and the geom names they speak of."""

from lerobot_act_chunking.envs.aloha.instructions import Goal

Contacts = frozenset[tuple[str, str]]
"""Names of the touching geoms, each pair in MuJoCo's own order (stock rewards depend on that order)."""

MAX_REWARD = 4
"""The reward gym-aloha counts as success."""

TABLE = "table"
CUBE = "red_box"
PEG = "red_peg"
PIN = "pin"
SOCKET_WALLS = ("socket-1", "socket-2", "socket-3", "socket-4")
# gym-aloha looks at one finger of each gripper only.
LEFT_FINGER = "vx300s_left/10_left_gripper_finger"
RIGHT_FINGER = "vx300s_right/10_right_gripper_finger"
_FINGERS = {"left": LEFT_FINGER, "right": RIGHT_FINGER}


def transfer_cube(contacts: Contacts, goal: Goal = Goal()) -> int:  # noqa: B008 (it is frozen)
    """Stock: 1 giving finger touches, 2 lifted by it, 3 taking finger touches, 4 and off the table."""
    giver, taker = (_FINGERS[arm] for arm in (goal.giver, goal.taker))
    lifted = (goal.geom, TABLE) not in contacts
    if (goal.geom, taker) in contacts:
        return 4 if lifted else 3
    if (goal.geom, giver) in contacts:
        return 2 if lifted else 1
    return 0


def insertion(contacts: Contacts) -> int:
    """Stock: 1 both objects touched, 2 both lifted, 3 peg touches socket in the air, 4 pin touched."""
    if (PEG, PIN) in contacts:
        return 4
    lifted = (PEG, TABLE) not in contacts and not _any_wall(contacts, TABLE)
    if lifted and any((PEG, wall) in contacts for wall in SOCKET_WALLS):
        return 3
    if (PEG, RIGHT_FINGER) in contacts and _any_wall(contacts, LEFT_FINGER):
        return 2 if lifted else 1
    return 0


def _any_wall(contacts: Contacts, other: str) -> bool:
    return any((wall, other) in contacts for wall in SOCKET_WALLS)
