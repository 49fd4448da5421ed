"""The declared map from the parameters of LeRobot's diffusion U-Net to those of `Unet1d`.

Every key of LeRobot's state dict is consumed exactly once; what is left over, or missing on our side, is an
error. The map is linear, so it also moves gradients.
"""

import torch
from torch import Tensor


class Map:
    """Moves entries from LeRobot's dictionary (weights, or gradients under the weights' names) to ours."""

    def __init__(self, theirs: dict[str, Tensor], time_dim: int):
        self.theirs = dict(theirs)
        self.time_dim = time_dim
        self.ours: dict[str, Tensor] = {}
        self.films: list[tuple[Tensor, Tensor]] = []

    def module(self, theirs: str, ours: str) -> None:
        for name in ("weight", "bias"):
            self.ours[f"{ours}.{name}"] = self.theirs.pop(f"{theirs}.{name}")

    def conv_block(self, theirs: str, ours: str) -> None:
        for i in (0, 1):  # convolution, group norm
            self.module(f"{theirs}.block.{i}", f"{ours}.{i}")

    def residual_block(self, theirs: str, ours: str) -> None:
        for conv in ("conv1", "conv2"):
            self.conv_block(f"{theirs}.{conv}", f"{ours}.{conv}")
        if f"{theirs}.residual_conv.weight" in self.theirs:
            self.module(f"{theirs}.residual_conv", f"{ours}.skip")
        film = f"{theirs}.cond_encoder.1"
        self.films.append((self.theirs.pop(f"{film}.weight"), self.theirs.pop(f"{film}.bias")))

    def level(self, theirs: str, ours: str) -> None:
        self.residual_block(f"{theirs}.0", f"{ours}.first")
        self.residual_block(f"{theirs}.1", f"{ours}.second")

    def stacked_films(self) -> None:
        """One matrix each for the time's and for the observation's columns of all blocks' linear layers."""
        weights = torch.cat([weight for weight, _ in self.films])
        self.ours["time_film.weight"] = weights[:, : self.time_dim]
        self.ours["observation_film.weight"] = weights[:, self.time_dim :]
        self.ours["observation_film.bias"] = torch.cat([bias for _, bias in self.films])


def convert(theirs: dict[str, Tensor], *, n_levels: int, time_dim: int) -> dict[str, Tensor]:
    """Our state dict (or gradients) from that of `DiffusionConditionalUnet1d`."""
    mapping = Map(theirs, time_dim)
    for i in (1, 3):
        mapping.module(f"diffusion_step_encoder.{i}", f"time_mlp.{i}")
    for i in range(n_levels):
        mapping.level(f"down_modules.{i}", f"down.{i}")
    mapping.level("mid_modules", "middle")
    for i in range(n_levels - 1):
        mapping.level(f"up_modules.{i}", f"up.{i}")
        mapping.module(f"down_modules.{i}.2", f"downsample.{i}")
        mapping.module(f"up_modules.{i}.2", f"upsample.{i}")
    mapping.stacked_films()
    mapping.conv_block("final_conv.0", "final")
    mapping.module("final_conv.1", "contract")
    assert not mapping.theirs, f"left over: {list(mapping.theirs)}"
    return mapping.ours
