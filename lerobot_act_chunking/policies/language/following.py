"""What policies that follow instructions have in common."""

from dataclasses import replace
from typing import Any

import torch
from jaxtyping import Float
from lerobot.utils.constants import OBS_LANGUAGE_TOKENS
from torch import Tensor

from lerobot_act_chunking.data.batch import Observation
from lerobot_act_chunking.errors import FeatureError
from lerobot_act_chunking.execution.environments import Environments
from lerobot_act_chunking.execution.executor import ChunkExecutor
from lerobot_act_chunking.nn.processes import draw_rows
from lerobot_act_chunking.policies.batch_seeds import BatchSeeds
from lerobot_act_chunking.policies.language.fields import INSTRUCTION
from lerobot_act_chunking.policies.language.instruction_encoder import InstructionEncoder
from lerobot_act_chunking.policies.language.watch import InstructionWatch

Batch = dict[str, Any]


class FollowsInstructions:
    """What `ChunkedPolicy` does about instructions, if it reads any.

    They are no part of the observed history: a new one counts for all observed steps at once, and for the
    actions that already wait to be executed.

    Attributes:
        instruction_encoder: None where the policy reads no instructions.
        instruction_seeds: of what training leaves out.
    """

    config: Any
    model: Any
    training: bool
    _network: Any
    _action_queue: ChunkExecutor
    _instructions: InstructionWatch
    _said: tuple[Any, Tensor] | None
    instruction_encoder: InstructionEncoder | None
    instruction_seeds: BatchSeeds | None
    register_load_state_dict_post_hook: Any

    def _load_instruction_encoder(self, meta: Any | None) -> None:
        """Load the sentence encoder, if there is one; see `InstructionEncoder`."""
        config, trained_on = self.config, None if meta is None or meta.episodes is None else meta
        self.instruction_encoder = (
            None if config.language_encoder is None else InstructionEncoder(config, trained_on)
        )
        self.instruction_seeds = BatchSeeds() if config.instruction_dropout else None
        self.register_load_state_dict_post_hook(_forget_what_was_said)

    def _forget_instructions(self) -> None:
        """Another rollout begins."""
        self._instructions, self._said = InstructionWatch(), None

    def _read_all_instructions(self) -> None:
        """Show the reader what the training will say."""
        if self.instruction_encoder is not None and self.instruction_encoder.tasks:
            embedding: Any = self.model.instruction
            encoded = self.instruction_encoder.encode_tasks()
            embedding.reader.fit(encoded.states, encoded.mask)

    def _drop_what_was_asked_before(self, batch: Batch) -> None:
        """Where the instruction is another one than in the last step, nothing waits any more."""
        changed = None if self.config.task_tokens is None else self._instructions.changed(batch)
        if changed is not None:
            self._action_queue.clear(changed)

    def _taught(self, window: Observation, batch: Batch) -> Observation:
        """The observations to learn from, with the instructions of the batch, of which some are left out."""
        if self.instruction_encoder is None:
            return window
        self._said = None  # the weights change
        drop = None
        if self.training and self.instruction_seeds is not None:
            device = next(self.model.parameters()).device
            generator = self.instruction_seeds.next_generator(device)
            drawn = draw_rows(torch.rand, (window.batch_size,), generator=generator, device=device)
            drop = drawn < self.config.instruction_dropout
        return self._with(window, self._network.instruction(*self.instruction_encoder.encode(batch), drop))

    def _instructed(self, window: Observation, batch: Batch, envs: Environments = None) -> Observation:
        """The observations of these environments to act on, with the instructions of the batch.

        What was made of the last step's instructions serves as long as their tokens are the same tensor.
        """
        if self.instruction_encoder is None:
            return window
        tokens = batch.get(OBS_LANGUAGE_TOKENS)
        if self._said is None or self._said[0] is not tokens:
            self._said = (
                tokens,
                self._network.instruction(*self.instruction_encoder.encode(batch, acting=True)),
            )
        said = self._said[1]
        return self._with(window, said if envs is None else said[envs.to(said.device)])

    def _with(self, window: Observation, said: Float[Tensor, "n V"]) -> Observation:
        if len(said) != window.batch_size:
            raise FeatureError(
                f"{OBS_LANGUAGE_TOKENS!r} has {len(said)} instructions for {window.batch_size} samples"
            )
        told = said[:, None].expand(-1, self.config.n_obs_steps, -1)
        return replace(window, vectors=window.vectors | {INSTRUCTION: told})


def _forget_what_was_said(policy: Any, _incompatible: Any) -> None:
    """Other weights make something else of the same instruction."""
    policy._said = None
