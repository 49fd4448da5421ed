"""Small untrained policies for ``aloha_sim``, with processors."""

import torch
from lerobot.configs import FeatureType, PolicyFeature, PreTrainedConfig
from lerobot.policies.factory import get_policy_class, make_pre_post_processors
from policy_cases import LENGTHS, MODULES, SIZES, TYPES

from lerobot_act_chunking.policies.loading import LoadedPolicy

CHUNK, JOINTS = 8, 14
OURS = TYPES[0]
SMALL = {
    OURS: {
        **SIZES[OURS],
        **MODULES[OURS].DETERMINISTIC,
        LENGTHS[OURS]: CHUNK,
        "execution": "open_loop",
    },
    "act": {
        "chunk_size": CHUNK,
        "dim_model": 16,
        "n_heads": 2,
        "dim_feedforward": 24,
        "n_encoder_layers": 1,
        "use_vae": False,
    },
}
STATE = {
    "observation.state": PolicyFeature(FeatureType.STATE, (JOINTS,)),
    "observation.environment_state": PolicyFeature(FeatureType.ENV, (7,)),
}
CAMERA = {"observation.images.top": PolicyFeature(FeatureType.VISUAL, (3, 48, 64))}
START = torch.tensor([0.0, -0.96, 1.16, 0.0, -0.3, 0.0, 0.5] * 2)


def make_policy(type_: str = OURS, inputs=STATE, start=START, **settings) -> LoadedPolicy:
    """An untrained policy that moves about the start pose."""
    actions = {"action": PolicyFeature(FeatureType.ACTION, tuple(start.shape))}
    config = PreTrainedConfig.get_choice_class(type_)(
        device="cpu",
        push_to_hub=False,
        input_features=dict(inputs),
        output_features=actions,
        **{**SMALL[type_], **settings},
    )
    torch.manual_seed(0)
    policy = get_policy_class(type_)(config).eval()
    shapes = {key: feature.shape for key, feature in inputs.items() if feature.type is not FeatureType.VISUAL}
    stats = {
        key: {"mean": torch.zeros(shape), "std": torch.full(shape, 0.5)} for key, shape in shapes.items()
    }
    stats |= {
        key: {"mean": torch.full((3, 1, 1), 0.5), "std": torch.ones(3, 1, 1)}
        for key in inputs
        if key not in shapes
    }
    stats["action"] = {"mean": start, "std": torch.full_like(start, 0.05)}
    return LoadedPolicy(policy, *make_pre_post_processors(config, dataset_stats=stats))


def save(policy: LoadedPolicy, folder) -> str:
    """Write a checkpoint, as lerobot-train does."""
    for part in policy:
        part.save_pretrained(folder)
    return str(folder)
