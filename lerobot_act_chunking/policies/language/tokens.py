"""The processor step that turns ``task`` into LeRobot's ``observation.language.tokens``."""

from collections import OrderedDict
from dataclasses import dataclass, field
from typing import Any

import torch
from lerobot.configs import FeatureType, PipelineFeatureType, PolicyFeature
from lerobot.lerobot_types import TransitionKey
from lerobot.processor import ObservationProcessorStep, ProcessorStepRegistry
from lerobot.utils.constants import OBS_LANGUAGE_ATTENTION_MASK, OBS_LANGUAGE_TOKENS
from torch import Tensor

from lerobot_act_chunking.errors import ConfigurationError
from lerobot_act_chunking.policies.language.encoder import load_encoder

REMEMBERED = 4096  # instructions


@dataclass
@ProcessorStepRegistry.register(name="act_chunking_instruction_tokens")
class InstructionTokens(ObservationProcessorStep):
    """Tokens of each sample's task, as LeRobot's ``tokenizer_processor`` makes them.

    LeRobot's own step keeps where the tokenizer lies on the machine of the training, and works anew in every
    control step. This one keeps the encoder's name, and an instruction is tokenised once.

    Attributes:
        encoder: as ``language_encoder`` names it.
        max_tokens: L; longer instructions are cut, which is warned of once.
    """

    encoder: str
    max_tokens: int
    _known: OrderedDict[str, tuple[Tensor, Tensor]] = field(default_factory=OrderedDict, init=False)
    _last: tuple[Any, tuple[Tensor, Tensor] | None] = field(default=((), None), init=False)

    def observation(self, observation: dict[str, Any]) -> dict[str, Any]:
        """The observations with ``observation.language.tokens`` (B, L) and their mask.

        Raises:
            ConfigurationError: a sample has no task.
        """
        tasks = self._tasks()
        like = next((each for each in observation.values() if isinstance(each, Tensor)), None)
        device = torch.device("cpu") if like is None else like.device
        asked, found = self._last
        if found is None or asked != (tasks, device):
            tokens, masks = zip(*(self._tokens(task) for task in tasks), strict=True)
            found = torch.stack(tokens).to(device), torch.stack(masks).to(device)
            self._last = (tasks, device), found
        observation[OBS_LANGUAGE_TOKENS], observation[OBS_LANGUAGE_ATTENTION_MASK] = found
        return observation

    def _tasks(self) -> tuple[str, ...]:
        task = (self.transition.get(TransitionKey.COMPLEMENTARY_DATA) or {}).get("task")
        tasks = (task,) if isinstance(task, str) else tuple(task or ())
        if not tasks or not all(isinstance(each, str) and each.strip() for each in tasks):
            raise ConfigurationError(
                f"the policy follows instructions, but the task is {task!r}: give one, as lerobot-rollout "
                "--task='...' does, a dataset in each episode's task, an environment in its task_description"
            )
        return tasks

    def _tokens(self, task: str) -> tuple[Tensor, Tensor]:
        """Tokens (L,) and their mask (L,)."""
        if task not in self._known:
            found = load_encoder(self.encoder).tokens(task, self.max_tokens)
            filling = self.max_tokens - len(found)
            mask = torch.tensor([True] * len(found) + [False] * filling)
            self._known[task] = torch.tensor(found + [0] * filling), mask
            if len(self._known) > REMEMBERED:
                self._known.popitem(last=False)
        return self._known[task]

    def get_config(self) -> dict[str, Any]:
        """What a checkpoint keeps."""
        return {"encoder": self.encoder, "max_tokens": self.max_tokens}

    def transform_features(
        self, features: dict[PipelineFeatureType, dict[str, PolicyFeature]]
    ) -> dict[PipelineFeatureType, dict[str, PolicyFeature]]:
        """The features with those that are added."""
        added = PolicyFeature(FeatureType.LANGUAGE, (self.max_tokens,))
        seen = features.get(PipelineFeatureType.OBSERVATION, {})
        both = {OBS_LANGUAGE_TOKENS: added, OBS_LANGUAGE_ATTENTION_MASK: added}
        return {**features, PipelineFeatureType.OBSERVATION: {**seen, **both}}
