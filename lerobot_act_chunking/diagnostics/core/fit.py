"""Whether a policy's training and a robot, or its recordings, go together: keys, sizes, names, units."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from lerobot.utils.constants import ACTION, OBS_STATE

from lerobot_act_chunking.data.dimension_names import given_names
from lerobot_act_chunking.diagnostics.core.normalisers import processor_statistics, spreads_of
from lerobot_act_chunking.policies.loading import LoadedPolicy
from lerobot_act_chunking.policies.trained_on import TrainedOn

BEYOND = 0.5  # of the demonstrated range, from which values beyond it are of other units or another pose
FAR = 0.25  # of the demonstrated range, from which the first action is a jump


@dataclass(frozen=True)
class Finding:
    """One thing that was compared: a ``level`` of pass, warn or fail, and what there is to say."""

    level: str
    text: str


def failed(findings: list[Finding]) -> bool:
    """Whether something does not fit."""
    return any(each.level == "fail" for each in findings)


def check_normalisation(policy: LoadedPolicy) -> list[Finding]:
    """Statistics that are missing, or leave numbers as they are."""
    config = getattr(policy.policy.config, "inner_config", policy.policy.config)
    spreads = spreads_of(processor_statistics(policy), config)
    inert = [key for key, each in spreads.items() if each is None or each.is_inert]
    if not inert:
        return [
            Finding("pass", "the processors normalise all that the policy was trained to have normalised")
        ]
    text = (
        f"the processors do not normalise {', '.join(inert)}: copy the whole folder of the checkpoint again"
    )
    return [Finding("fail", text)]


def check_fit(config: Any, known: TrainedOn, there: Mapping[str, Any]) -> list[Finding]:
    """Keys, sizes and names of what the policy reads and does, against a robot's or a dataset's."""
    wanted = {**(config.input_features or {}), **(config.output_features or {})}
    found = []
    for key, feature in wanted.items():
        if key not in there:
            text = f"there is no {key}, but {', '.join(k for k in there if k[:3] == key[:3]) or 'nothing'}"
            found.append(Finding("fail", f"{text}: name it so (cameras in --robot.cameras or --rename_map)"))
            continue
        shape, size = tuple(feature.shape), tuple(there[key]["shape"])
        size = size if len(size) == 1 or size[0] in (1, 3) else (size[2], *size[:2])
        if shape != size:
            text = f"{key} has the size {size}, but the policy was trained with {shape}: set it to that"
            found.append(Finding("fail", text))
        elif len(shape) == 1:
            found += _check_names(key, known.names.get(key), given_names(there[key]))
    return found or [Finding("pass", "keys, sizes and names are those of the training")]


def _check_names(key: str, ours: list[str] | None, theirs: tuple[str, ...]) -> list[Finding]:
    if not ours or not theirs:
        return [
            Finding("warn", f"names of {key} are not known, so their order cannot be compared: look at it")
        ]
    if list(theirs) == ours:
        return []
    text = f"{key} is {', '.join(theirs)}, but the policy was trained with {', '.join(ours)}, in this order"
    return [Finding("fail", f"{text}: use the robot that it was recorded with, or train again")]


def check_pose(known: TrainedOn, batch: dict[str, Any], action: np.ndarray) -> list[Finding]:
    """An observation and the first action, against the ranges of the demonstrations."""
    found = []
    for key in known.low:
        if key in batch:
            low, high = np.array(known.low[key]), np.array(known.high[key])
            value, span = batch[key].reshape(-1).numpy(), known.spans(key)
            outside = np.maximum(low - value, value - high) > BEYOND * span
            names = known.names.get(key, [f"{key} {dim}" for dim in range(len(low))])
            found += [
                Finding(
                    "fail",
                    f"{names[dim]} is at {value[dim]:.4g}, far from the demonstrated {low[dim]:.4g} to "
                    f"{high[dim]:.4g}: check units (degrees or -100 to 100) and calibration, or start nearer",
                )
                for dim in np.flatnonzero(outside)
            ]
    names = known.names.get(ACTION)
    if names and names == known.names.get(OBS_STATE) and ACTION in known.low and OBS_STATE in batch:
        span = known.spans(ACTION)
        moves = np.abs(action - batch[OBS_STATE].reshape(-1).numpy())
        worst = int((moves / span).argmax())
        text = (
            f"the first action moves {names[worst]} by {moves[worst]:.3g} of a demonstrated {span[worst]:.3g}"
        )
        far = moves[worst] > FAR * span[worst]
        fix = ": begin where demonstrations begin, at low speed" if far else ""
        found.append(Finding("warn" if far else "pass", text + fix))
    return found
