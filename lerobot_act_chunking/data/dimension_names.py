"""What the dimensions of a LeRobot feature are called."""

from collections import Counter
from collections.abc import Iterator, Mapping
from typing import Any

HANDS = ("gripper", "hand", "finger", "thumb")


def dimension_names(feature: Mapping[str, Any]) -> tuple[str, ...]:
    """One name for each number of a vector, all different.

    LeRobot's datasets hold names as a list, a list within a list, groups (``{"motors": [...]}``), or not at
    all.

    Args:
        feature: as in ``meta/info.json``, with ``shape`` (A,) and ``names``.

    Returns:
        A names; ``action_0``, ``action_1``, ... where there are none, or not as many as dimensions. Names
        that occur more than once are numbered.
    """
    (width,) = feature["shape"]
    return given_names(feature) or tuple(f"action_{dim}" for dim in range(width))


def given_names(feature: Mapping[str, Any]) -> tuple[str, ...]:
    """As `dimension_names`, but no names where there are none, or not as many as dimensions."""
    names = list(_flat(feature.get("names")))
    if len(names) != feature["shape"][0]:
        return ()
    times = Counter(names)
    return tuple(f"{name}_{dim}" if times[name] > 1 else name for dim, name in enumerate(names))


def is_hand(name: str) -> bool:
    """Whether a dimension is a gripper, or a joint of a hand, by its name."""
    return any(part in name.lower() for part in HANDS)


def _flat(names: Any) -> Iterator[str]:
    """The leaves of nested lists and groups, in their order."""
    if names is None:
        return
    if isinstance(names, str):
        yield names
        return
    members = names.values() if isinstance(names, Mapping) else names
    if isinstance(names, Mapping) and all(isinstance(value, int) for value in members):
        yield from names  # {"shoulder": 0, "elbow": 1}
        return
    for member in members:
        yield from _flat(member)
