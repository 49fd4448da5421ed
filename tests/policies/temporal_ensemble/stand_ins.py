"""Stand-ins for LeRobot's policies whose networks need downloads: their settings are genuine, and so is how
they treat queues, batches and arguments; the network is a linear map.
"""

from collections import deque

import pytest
import torch
from lerobot.configs import FeatureType, PolicyFeature
from lerobot.policies.factory import get_policy_class
from lerobot.policies.multi_task_dit.configuration_multi_task_dit import MultiTaskDiTConfig
from lerobot.policies.pretrained import PreTrainedPolicy
from lerobot.policies.smolvla.configuration_smolvla import SmolVLAConfig
from lerobot.policies.utils import populate_queues
from torch import nn

from lerobot_act_chunking.policies.temporal_ensemble import modeling_temporal_ensemble
from lerobot_act_chunking.policies.temporal_ensemble.configuration_temporal_ensemble import (
    TemporalEnsembleConfig,
)

A, S = 4, 6
TOKENS = "observation.language.tokens"
FEATURES = {
    "input_features": {
        "observation.state": PolicyFeature(FeatureType.STATE, (S,)),
        "observation.images.left": PolicyFeature(FeatureType.VISUAL, (3, 8, 8)),
        "observation.images.right": PolicyFeature(FeatureType.VISUAL, (3, 8, 8)),
    },
    "output_features": {"action": PolicyFeature(FeatureType.ACTION, (A,))},
}


class StandIn(PreTrainedPolicy):
    """A policy that is a linear map, whatever its interface."""

    config_class = SmolVLAConfig
    name = "stand_in"

    def __init__(self, config, **_):
        super().__init__(config)
        self.linear = nn.Linear(S, self.length * A)
        self.reset()

    def chunk(self, state, images, tokens):
        chunk = self.linear(state).unflatten(-1, (self.length, A))
        return chunk + images.mean((-3, -2, -1))[:, None, None] + tokens.float().mean(-1)[:, None, None]

    def get_optim_params(self):
        return self.parameters()

    def forward(self, batch, reduction="mean"):
        loss = (self.linear(batch["observation.state"]).unflatten(-1, (self.length, A)) ** 2).mean((1, 2))
        return (loss if reduction == "none" else loss.mean()), {}


class StandInDiT(StandIn):
    """multi_task_dit: a history in queues, stacked cameras, tokens beside them, a batch it writes into."""

    config_class = MultiTaskDiTConfig
    name = "multi_task_dit"

    @property
    def length(self):
        return self.config.horizon

    def reset(self):
        steps = self.config.n_obs_steps
        self._queues = {
            "observation.state": deque(maxlen=steps),
            "action": deque(maxlen=self.config.n_action_steps),
            "observation.images": deque(maxlen=steps),
        }

    @torch.no_grad()
    def predict_action_chunk(self, batch):
        for k in batch:
            if k in self._queues:
                batch[k] = torch.stack(list(self._queues[k]), dim=1)
        state, images, steps = (
            batch["observation.state"],
            batch["observation.images"],
            self.config.n_obs_steps,
        )
        assert state.shape[1] == images.shape[1] == steps
        weights = torch.arange(1.0, steps + 1)
        chunk = self.chunk((state * weights[:, None]).sum(1), images[:, :, 0], batch[TOKENS])
        return chunk[:, steps - 1 : steps - 1 + self.config.n_action_steps]

    def select_action(self, batch):
        batch = {key: value for key, value in batch.items() if key != "action"}
        cameras = [batch[key] for key in self.config.image_features]
        batch["observation.images"] = torch.stack(cameras, dim=-4)
        self._queues = populate_queues(self._queues, batch)
        if len(self._queues["action"]) == 0:
            self._queues["action"].extend(self.predict_action_chunk(batch).transpose(0, 1))
        return self._queues["action"].popleft()

    def chunk(self, state, images, tokens):
        return super().chunk(state, images.sum(1), tokens)


class StandInVLA(StandIn):
    """smolvla: no history, real-time chunking, a state it changes in place."""

    config_class = SmolVLAConfig
    name = "smolvla"

    @property
    def length(self):
        return self.config.chunk_size

    def supports_rtc(self):
        return True

    def init_rtc_processor(self):
        self.rtc_config = self.config.rtc_config

    def reset(self):
        self._queues = {"action": deque(maxlen=self.config.n_action_steps)}
        self.received = []

    @torch.no_grad()
    def predict_action_chunk(self, batch, noise=None, **kwargs):
        self.received.append({"noise": noise, **kwargs})
        batch["observation.state"][:, 0] += 1
        images = batch["observation.images.left"] + 2 * batch["observation.images.right"]
        tokens = batch.get(TOKENS, torch.zeros(len(images), 1))
        return self.chunk(batch["observation.state"], images, tokens)

    def select_action(self, batch):
        if len(self._queues["action"]) == 0:
            batch = {**batch, "observation.state": batch["observation.state"].clone()}
            chunk = self.predict_action_chunk(batch)[:, : self.config.n_action_steps]
            self._queues["action"].extend(chunk.transpose(0, 1))
        return self._queues["action"].popleft()


STAND_INS = {"multi_task_dit": StandInDiT, "smolvla": StandInVLA}
INNER = {
    "multi_task_dit": {"type": "multi_task_dit", "n_obs_steps": 2, "horizon": 8, "n_action_steps": 3},
    "smolvla": {"type": "smolvla", "chunk_size": 7, "n_action_steps": 3},
}


@pytest.fixture
def stand_ins(monkeypatch):
    """Build stand-ins wherever the wrapper would build the real policies."""
    monkeypatch.setattr(
        modeling_temporal_ensemble,
        "get_policy_class",
        lambda name: STAND_INS.get(name) or get_policy_class(name),
    )


def wrapped(policy_type, **execution):
    config = TemporalEnsembleConfig(
        inner=INNER[policy_type], device="cpu", push_to_hub=False, **FEATURES, **execution
    )
    torch.manual_seed(0)
    return modeling_temporal_ensemble.TemporalEnsemblePolicy(config).eval()


def bare(policy_type):
    """The stand-in itself, with the weights of `wrapped`."""
    policy = STAND_INS[policy_type](wrapped(policy_type).config.inner_config).eval()
    policy.load_state_dict(wrapped(policy_type).inner.state_dict())
    return policy


def batch(seed, batch_size=3):
    generator = torch.Generator().manual_seed(seed)
    values = {
        key: torch.empty(batch_size, *feature.shape).normal_(generator=generator)
        for key, feature in FEATURES["input_features"].items()
    }
    values[TOKENS] = torch.randint(9, (batch_size, 5), generator=generator)
    return {**values, "task": ["fold"] * batch_size, "action": None, "info": {}}
