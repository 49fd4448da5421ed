"""Whether the codes of a policy that predicts codes tell the ways apart."""

from typing import Any

import numpy as np
import torch
from jaxtyping import Int64

from lerobot_act_chunking.data.batch import ActionTarget
from lerobot_act_chunking.data.masking import hold_padding
from lerobot_act_chunking.diagnostics.core.samples import Samples
from lerobot_act_chunking.diagnostics.modes.demonstrated import Demonstrated
from lerobot_act_chunking.diagnostics.modes.inside import CodeModes
from lerobot_act_chunking.execution.interpolation import upsample
from lerobot_act_chunking.policies.loading import LoadedPolicy


@torch.no_grad()
def measure_codes(
    loaded: LoadedPolicy, starts: Samples, demonstrated: Demonstrated, modes: Int64[np.ndarray, " N"], n: int
) -> CodeModes:
    """Code the demonstrations' first chunks, and see which ways the codes alone go.

    Args:
        loaded: a policy with a tokenizer.
        starts: first frames of N demonstrations.
        demonstrated: all demonstrations.
        modes: the way of each of the N.
        n: how many ways there are.
    """
    policy: Any = loaded.policy
    config, parts = policy.config, []
    for raw in starts.batches():
        target = ActionTarget.from_lerobot(
            loaded.preprocessor(raw), config.feature_spec, config.action_delta_indices
        )
        windows = policy.windows[config.n_obs_steps - 1]  # the chunk of the current step
        codes = policy.tokenizer.encode(hold_padding(target.actions, target.is_pad)[:, windows])
        steps = upsample(policy.tokenizer.decode(codes), config.chunk_stride, config.gripper_dims)
        chunks = loaded.postprocessor(steps.flatten(0, 1)).cpu().unflatten(0, steps.shape[:2])
        parts.append((codes.cpu(), chunks.double()))
    codes, chunks = (torch.cat(each).numpy() for each in zip(*parts, strict=True))
    right = demonstrated.reference(0, chunks.shape[1]).classify(demonstrated.scaled(chunks)) == modes
    used = [{tuple(code) for code in codes[modes == mode].tolist()} for mode in range(n)]
    every = [code for of_mode in used for code in of_mode]
    return CodeModes(
        used=[len(each) for each in used],
        shared=sum(every.count(code) > 1 for code in set(every)),
        reconstructed=[float(right[modes == m].mean()) if (modes == m).any() else None for m in range(n)],
    )
