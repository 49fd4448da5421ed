"""What the default targets of PEFT adapters are held to, for policies and for the wrapper over them."""

import re

import pytest
import torch
from policy_cases import CASES, A, B, history_batch, of_every_type
from torch import nn

ADAPTABLE = (nn.Linear, nn.Embedding, nn.Conv1d, nn.Conv2d, nn.Conv3d, nn.MultiheadAttention)  # by PEFT
ADAPTED = [*CASES, *of_every_type("ADAPTED")]


def make(case, **overrides):
    return case.policy(use_ema=False, **overrides)


def named_by(policy):
    """The modules that the default pattern names, and those that are trained whole, as PEFT finds them."""
    defaults = policy._get_default_peft_targets()
    modules = dict(policy.named_modules())
    adapted = {name for name in modules if re.fullmatch(defaults["target_modules"], name)}
    saved = [{name for name in modules if name.endswith(end)} for end in defaults["modules_to_save"]]
    return modules, adapted, saved


def check_names(policy):
    modules, adapted, saved = named_by(policy)
    assert adapted
    assert {name for name in adapted if not isinstance(modules[name], ADAPTABLE)} == set()
    for names in saved:  # PEFT keeps these whole: nothing within them is adapted
        (whole,) = names
        assert not any(name.startswith(f"{whole}.") for name in adapted)


def check_learning(case, policy):
    """Adapters learn and are in effect."""
    pytest.importorskip("peft")
    policy.eval()
    policy.config.pretrained_path = "somewhere"
    for parameter in policy.parameters():  # some layers are zero at first, and hide what is before them
        parameter.data += 0.1 * torch.randn(parameter.shape, generator=torch.Generator().manual_seed(2))
    batch = history_batch(policy)
    noise = {name: value for name, value in case.noise(B).items() if value.ndim > 1}
    before = policy.predict_action_chunk(batch, **noise)
    adapted = policy.wrap_with_peft(peft_cli_overrides={"r": 2})
    learning = {name: p for name, p in adapted.named_parameters() if p.requires_grad}
    assert all("lora_" in name or "modules_to_save" in name for name in learning)
    torch.testing.assert_close(adapted.predict_action_chunk(batch, **noise), before)
    loss, _ = adapted.train().forward(batch)
    loss.backward()
    assert any(p.grad is not None and p.grad.any() for name, p in learning.items() if "lora_" in name)
    for name, parameter in learning.items():
        if "lora_B" in name:  # zero at first, so that nothing changes
            parameter.data.fill_(0.3)
    assert (adapted.predict_action_chunk(batch, **noise) - before).abs().max() > 1e-4
    assert adapted.select_action(case.batch()).shape[1] == A
