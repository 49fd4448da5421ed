"""A process of its own, without the shape checks of the tests, which torch.compile cannot trace.

Prints the largest differences between a compiled and an eager `act_chunked` over batches of several sizes.
"""

import torch
from policy_cases import CASES

(VECTORS,) = (case for case in CASES if case.type == "act_chunked" and case.name == "vectors")


def learn(policy, batch):
    policy.zero_grad(set_to_none=True)
    loss, _ = policy.train().forward(batch)
    loss.backward()
    return [loss.detach(), *(parameter.grad for parameter in policy.parameters())]


def main():
    compile_ = torch.nn.Module.compile  # traced as usual, but not turned into C++, which takes minutes
    torch.nn.Module.compile = lambda self, **how: compile_(self, backend="eager", **how)
    compiled, eager = (VECTORS.policy(compile_model=compiling) for compiling in (True, False))
    assert compiled.state_dict().keys() == eager.state_dict().keys()
    for policy in (compiled, eager):
        policy.batch_seeds.seed.fill_(0)  # the same noise of the latent
    for batch_size in (3, 8, 1):
        batch = VECTORS.batch(batch_size)
        pairs = zip(learn(compiled, batch), learn(eager, batch), strict=True)
        print(max((ours - theirs).abs().max().item() for ours, theirs in pairs))
        compiled.reset()
        with torch.inference_mode():  # behind which the next size is learned
            acted = compiled.select_action(batch) - eager.predict_action_chunk(batch)[:, 0]
        print(acted.abs().max().item())


if __name__ == "__main__":
    main()
