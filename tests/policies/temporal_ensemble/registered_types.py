"""An inner policy of every type that LeRobot knows, small where its settings allow it."""

import torch
from lerobot.configs import FeatureType, PolicyFeature, PreTrainedConfig
from wrapped_cases import ACTIONS, CASES, STATE, A, B

from lerobot_act_chunking.policies.temporal_ensemble.configuration_temporal_ensemble import (
    TemporalEnsembleConfig,
)
from lerobot_act_chunking.policies.temporal_ensemble.modeling_temporal_ensemble import TemporalEnsemblePolicy

SQUARE = {"observation.image": PolicyFeature(FeatureType.VISUAL, (3, 64, 64))}
TDMPC = {
    "type": "tdmpc",
    "latent_dim": 8,
    "mlp_dim": 16,
    "n_gaussian_samples": 12,
    "n_pi_samples": 3,
    "n_elites": 5,
    "cem_iterations": 2,
}
OWN_BACKBONE = {"pretrained_backbone_weights": None}
SMALL = {case.type: case.inner for case in CASES.values()}
SMALL = {name: {**settings, **OWN_BACKBONE} for name, settings in SMALL.items()} | {"tdmpc": TDMPC}
IN_THE_GATE = ("act", "tdmpc", "vqbet_chunked")
UNWRAPPABLE = {
    "gaussian_actor": "single actions",
    "lingbot_va": "frames and actions",
    "temporal_ensemble": "itself",
}


def registered_types():
    from lerobot.utils.import_utils import register_third_party_plugins

    register_third_party_plugins()
    return sorted(PreTrainedConfig.get_known_choices())


def wrapped_config(policy_type, **execution):
    return TemporalEnsembleConfig(
        inner=SMALL.get(policy_type, {"type": policy_type}),
        input_features=STATE | SQUARE,
        output_features=dict(ACTIONS),
        device="cpu",
        push_to_hub=False,
        **execution,
    )


def make_wrapper(policy_type, **execution):
    torch.manual_seed(0)
    policy = TemporalEnsemblePolicy(wrapped_config(policy_type, **execution)).eval()
    if policy_type == "vqbet":  # as after its first phase of training
        policy.inner.vqbet.action_head.vqvae_model.discretized.fill_(True)
    return policy


def observation(seed=1, batch_size=B):
    generator = torch.Generator().manual_seed(seed)
    shapes = {key: feature.shape for key, feature in (STATE | SQUARE).items()}
    return {key: torch.rand(batch_size, *shape, generator=generator) for key, shape in shapes.items()}


def training_batch(config):
    """What LeRobot's dataset gives for this policy, with the time axes that it asks for."""
    steps, n_actions = config.observation_delta_indices, len(config.action_delta_indices)
    batch = observation()
    if steps is not None:
        batch = {key: torch.stack([value] * len(steps), dim=1) for key, value in batch.items()}
        batch |= {f"{key}_is_pad": torch.zeros(B, len(steps), dtype=torch.bool) for key in STATE | SQUARE}
    if config.reward_delta_indices is not None:
        n_rewards = len(config.reward_delta_indices)
        batch["next.reward"] = torch.rand(B, n_rewards, generator=torch.Generator().manual_seed(3))
        batch["next.reward_is_pad"] = torch.zeros(B, n_rewards, dtype=torch.bool)
    batch["action"] = torch.rand(B, n_actions, A, generator=torch.Generator().manual_seed(2))
    batch["action_is_pad"] = torch.zeros(B, n_actions, dtype=torch.bool)
    return batch | {"index": torch.arange(B)}
