"""Whether the two architectures are of one size, and do as much work."""

from dataclasses import dataclass

import torch
from torch.nn.attention import SDPBackend, sdpa_kernel
from torch.utils.flop_counter import FlopCounterMode

from lerobot_act_chunking.diagnostics.lm_ablation.settings import Thresholds
from lerobot_act_chunking.nn.language.encoder import TextEncoder, TextEncoderSpec
from lerobot_act_chunking.nn.language.make import ENCODERS, body_parameters, make_text_encoder
from lerobot_act_chunking.nn.language.text import Text


@dataclass(frozen=True)
class Match:
    """Weights and work of both encoders' bodies.

    Attributes:
        parameters: weights of each architecture's layers.
        flops: of each, for one observation with the longest instruction, forward.
    """

    parameters: dict[str, int]
    flops: dict[str, int]

    @property
    def parameters_apart(self) -> float:
        """Difference as a share of the transformer's."""
        return _apart(self.parameters)

    @property
    def flops_apart(self) -> float:
        """Difference as a share of the transformer's."""
        return _apart(self.flops)

    def problems(self, thresholds: Thresholds) -> list[str]:
        """What makes the comparison unfair."""
        kinds = (
            ("weights", self.parameters_apart, thresholds.parameters),
            ("work", self.flops_apart, thresholds.flops),
        )
        return [
            f"the mixer's {what} differ from the transformer's by {100 * apart:.1f} %, more than "
            f"{100 * most:g} %: what they do differently may be for that"
            for what, apart, most in kinds
            if apart > most
        ]


def match(spec: TextEncoderSpec) -> Match:
    """Both architectures, measured."""
    encoders = {kind: make_text_encoder(kind, spec).eval() for kind in ENCODERS}
    return Match(
        {kind: body_parameters(each) for kind, each in encoders.items()},
        {kind: _flops(each) for kind, each in encoders.items()},
    )


@torch.no_grad()
def _flops(encoder: TextEncoder) -> int:
    spec = encoder.spec
    robot = torch.zeros(1, spec.n_robot_tokens, spec.dim)
    text = None
    if spec.vocabulary:
        tokens = torch.zeros(1, spec.text_tokens, dtype=torch.int64)
        text = Text(tokens, torch.zeros_like(tokens, dtype=torch.bool))
    # Fused attention would go uncounted.
    with FlopCounterMode(display=False) as counter, sdpa_kernel(SDPBackend.MATH):
        encoder(robot, robot[0], text)
    return counter.get_total_flops()


def _apart(of: dict[str, int]) -> float:
    return abs(of["mixer"] / of["bert"] - 1)
