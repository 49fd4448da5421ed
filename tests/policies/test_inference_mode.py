"""Acting under ``torch.inference_mode()``, as LeRobot evaluates, leaves nothing that training trips over."""

import pytest
from life_of_a_policy import assert_the_mode_does_not_matter
from policy_cases import CASES, STATE, TOP, WRAPPED, Case, history_batch

HISTORY = {"n_obs_steps": 3, "execution": "receding"}
KEPT = [  # what a policy can keep from step to step beside its plan
    Case("frames", "act_chunked", STATE | TOP, {**HISTORY, "use_velocity": True, "replan_interval": 1}),
    Case(
        "held latent", "act_chunked", STATE, {"use_vae": True, "z_inference": "sample", "z_hold": "episode"}
    ),
    Case("crossfade", "act_chunked", STATE, {"execution": "crossfade"}),
    Case("adaptive", "act_chunked", STATE, {"execution": "adaptive"}),
    Case("frames", "diffusion_chunked", STATE | TOP, {**HISTORY, "horizon": 7}),
    Case("held noise", "diffusion_chunked", STATE, {"warm_start": "noise_hold", "replan_interval": 2}),
    Case("edited", "diffusion_chunked", STATE, {"warm_start": "sdedit", "replan_interval": 2}),
    Case(
        "guided", "diffusion_chunked", STATE, {"warm_start": "rtc", "rtc_vjp": "exact", "replan_interval": 2}
    ),
    Case("coherent", "diffusion_chunked", STATE, {"execution": "coherence", "n_samples": 3}),
    Case("frames", "vqbet_chunked", STATE | TOP, {**HISTORY, "replan_interval": 1}),
    Case("held codes", "vqbet_chunked", STATE, {"code_hold": "episode", "execution": "ensemble"}),
]


@pytest.mark.parametrize("case", [*CASES, WRAPPED, *KEPT], ids=lambda case: f"{case.type}-{case.name}")
def test_training_goes_on_after_acting_in_inference_mode(case):
    batch = history_batch(case.policy()) if case.config().n_obs_steps > 1 else case.batch()
    observation = {key: value for key, value in case.batch().items() if key.startswith("observation")}
    assert_the_mode_does_not_matter(case.policy, observation, batch)
