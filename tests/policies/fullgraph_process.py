"""A process of its own, without the shape checks of the tests, which torch.compile cannot trace.

Every network part of every case is compiled as one graph, in training and in acting; prints what differs.
"""

import sys

import torch
from policy_cases import CASES, history_batch

from lerobot_act_chunking.nn.dropout import Dropout

PARTS = {
    "act_chunked": ("observation_encoder", "style_encoder", "encoder", "decoder"),
    "diffusion_chunked": ("condition", "denoiser"),
    "vqbet_chunked": ("history", "gpt"),
}


def learned(policy, batch):
    """The loss and the gradients of a batch, and the chunk that is predicted after it."""
    torch.manual_seed(1)
    policy.zero_grad(set_to_none=True)
    loss, _ = policy.train().forward(batch)
    loss.backward()
    observation = {key: value for key, value in batch.items() if not key.startswith("action")}
    chunk = policy.predict_action_chunk(observation)
    return [loss.detach(), *(each.grad for each in policy.parameters() if each.grad is not None), chunk]


def main(backend):
    for case in CASES:
        eager, compiled = case.policy(dropout=0.0), case.policy(dropout=0.0)
        parts = [getattr(compiled.model, name) for name in PARTS[case.type]]
        for part in filter(None, parts):
            part.compile(fullgraph=True, dynamic=False, backend=backend)
        torch._dynamo.reset()
        batch = history_batch(eager, 3)
        pairs = list(zip(learned(compiled, batch), learned(eager, batch), strict=True))
        print(max((ours - theirs).abs().max().item() for ours, theirs in pairs), case.type, case.name)
    dropout = Dropout(0.5).train()
    dropout.compile(fullgraph=True, backend=backend)  # its draws differ from those without
    print((dropout(torch.ones(100)).count_nonzero() == 100).item() * 1.0, "dropout")


if __name__ == "__main__":
    main(*sys.argv[1:])
