"""How the joints of a robot follow their commands: each, and together where they lag alike."""

from collections.abc import Sequence
from dataclasses import dataclass, field

from lerobot_act_chunking.diagnostics.core.lag import (
    MAX_LAG_SECONDS,
    Lag,
    LagGroup,
    LagProducts,
    group_lags,
    lag_products,
    made_from_states,
)
from lerobot_act_chunking.diagnostics.core.trajectories import Trajectories, UndefinedMeasureError

MADE_FROM_STATES = (
    "The action is the state {later} step(s) later, to the bit: nobody commanded anything (an arm moved by "
    "hand, or actions made from states), and there is no lag of the robot."
)


@dataclass(frozen=True)
class Tracking:
    """Lags of joints and of groups; None where nothing reliable can be said, with its reason.

    Attributes:
        joints: of each.
        groups: of each group of dimensions.
        alike: joints whose lag is known, by lag.
        undefined: reasons, by the name of the joint or group.
        note: what to know about all of them.
    """

    joints: dict[str, Lag | None]
    groups: dict[str, Lag | None]
    alike: list[LagGroup] = field(default_factory=list)
    undefined: dict[str, str] = field(default_factory=dict)
    note: str | None = None


def track(
    commands: Trajectories,
    positions: Trajectories,
    dt: float,
    names: Sequence[str],
    groups: dict[str, list[int]],
    moving: Sequence[int],
    reach_s: float = MAX_LAG_SECONDS,
) -> Tracking:
    """Measure every lag.

    Args:
        commands: ``(T, A)`` each, in units that make dimensions comparable.
        positions: the same of what the robot did; none, if that is not known.
        dt: control period [s].
        names: of the A dimensions.
        groups: dimensions by the group's name.
        moving: dimensions that move; the others have no lag.
        reach_s: longest lag to look for [s]; half of the longest episode at most.
    """
    later = made_from_states(commands, positions, moving) if len(positions) else None
    if not len(positions) or later is not None:
        note = None if later is None else MADE_FROM_STATES.format(later=later)
        undefined = {} if note is None else dict.fromkeys((*names, *groups), note)
        return Tracking(dict.fromkeys(names), dict.fromkeys(groups), undefined=undefined, note=note)
    products = lag_products(commands, positions, dt, reach_s)
    undefined: dict[str, str] = {}
    joints = {
        name: _lag(products, [dim], name, undefined) if dim in moving else None
        for dim, name in enumerate(names)
    }
    undefined |= {name: "it hardly moves" for dim, name in enumerate(names) if dim not in moving}
    known = {name: lag for name, lag in joints.items() if lag is not None}
    found: dict[str, Lag | None] = {}
    for group, dims in groups.items():
        reliable = [dim for dim in dims if names[dim] in known]
        apart = group_lags({names[dim]: known[names[dim]] for dim in reliable}, dt)
        if len(apart) == 1:
            found[group] = _lag(products, reliable, group, undefined)
        else:
            found[group] = None
            undefined[group] = "its joints lag differently" if apart else "of none of its joints is it known"
    return Tracking(joints, found, group_lags(known, dt), undefined)


def _lag(products: LagProducts, dims: list[int], name: str, undefined: dict[str, str]) -> Lag | None:
    try:
        return products.lag(dims)
    except UndefinedMeasureError as reason:
        undefined[name] = str(reason)
        return None
