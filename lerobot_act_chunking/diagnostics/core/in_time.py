"""How long a policy's chunks take, and in which ways it can act with them in time."""

import math
import time
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch

from lerobot_act_chunking.policies.chunk_length import chunk_length
from lerobot_act_chunking.policies.execution_fields import ExecutionFields
from lerobot_act_chunking.policies.loading import LoadedPolicy

WARM_UP, MEASURED = 2, 20  # chunks


@dataclass(frozen=True)
class Way:
    """A way of acting, whether the policy is fast enough for it, and why."""

    option: str
    go: bool
    text: str


def act(policy: LoadedPolicy, batch: dict[str, Any]) -> np.ndarray:
    """The action (A,) of a control step, on the CPU."""
    with torch.inference_mode():
        action = policy.policy.select_action(policy.preprocessor(dict(batch)))
        return policy.postprocessor(action).reshape(-1).cpu().numpy()


def time_chunks(policy: LoadedPolicy, batch: dict[str, Any]) -> list[float]:
    """How long the control step of a new chunk takes [s], processors included."""
    taken = []
    for _ in range(WARM_UP + MEASURED):
        policy.reset()
        began = time.perf_counter()
        act(policy, batch)
        taken.append(time.perf_counter() - began)
    return taken[WARM_UP:]


def play(policy: LoadedPolicy, batches: list[dict[str, Any]], fps: float) -> list[float]:
    """How long each control step takes [s] when the policy acts on these observations in real time."""
    policy.reset()
    taken = []
    for batch in batches:
        began = time.perf_counter()
        act(policy, batch)
        taken.append(time.perf_counter() - began)
        time.sleep(max(0.0, 1 / fps - taken[-1]))
    policy.reset()
    return taken


def ways_to_act(config: Any, policy: Any, longest_s: float, fps: float) -> list[Way]:
    """For each way of acting, whether a chunk that takes so long is there in time."""
    delay, length = math.ceil(longest_s * fps), chunk_length(config)
    took = f"a chunk takes up to {1000 * longest_s:.0f} ms, {delay} control step{'s' * (delay != 1)}"
    in_time = delay < length
    lasts = f"{took}; it lasts {length}"
    ours = isinstance(config, ExecutionFields)
    settings: Any = getattr(config, "execution_settings", None)
    used = settings.n_action_steps if ours else length
    opened = ours and config.execution == "open_loop"
    if not ours:
        background = "not for this type: act-chunking wrap makes it possible"
    elif opened:
        background = "not with execution=open_loop: add --policy.execution=crossfade"
    else:
        background = f"{took}; {used} are used of it"
    rtc = getattr(policy, "supports_rtc", lambda: False)()
    return [
        Way(
            "--inference.type=sync", longest_s < 1 / fps, f"{took}: so long the robot stands still each time"
        ),
        Way("--policy.background=true", ours and not opened and delay < used, background),
        Way("--inference.type=rtc", rtc and in_time, lasts if rtc else "not for this type"),
        Way("act-chunking serve", in_time, f"{lasts}; the network's time comes on top"),
    ]
