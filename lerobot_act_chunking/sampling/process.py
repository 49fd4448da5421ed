"""Noising processes: how clean actions and noise mix, and what a network is asked about the mixture."""

from abc import ABC, abstractmethod
from dataclasses import dataclass, field
from typing import Any, ClassVar

import torch
from jaxtyping import Float
from torch import Tensor

from lerobot_act_chunking.errors import ConfigurationError, unknown_choice

Levels = tuple[Float[Tensor, "*S"], Float[Tensor, "*S"]]  # alpha, sigma

BETA_SCHEDULES = ("squaredcos_cap_v2", "linear", "scaled_linear")
TIME_DISTRIBUTIONS = ("uniform", "beta", "logit_normal")


@dataclass(frozen=True)
class Process(ABC):
    """Mixes actions with noise, ``x = alpha(t) * actions + sigma(t) * noise``, and reads a network's answer.

    The network's answer is a fixed mixture too, ``p * actions + q * noise``, of which `clean` solves the two
    equations for the actions. Times are what the network sees, one for each chunk (B,), one for each action
    (B, T), or one for all.

    Args:
        prediction_type: what the network is asked for, one of ``prediction_types``.
    """

    name: ClassVar[str]
    clean_time: ClassVar[float]  # at which x is the actions: levels (1, 0)
    prediction_types: ClassVar[tuple[str, ...]]
    prediction_type: str

    def __post_init__(self) -> None:
        if self.prediction_type not in self.prediction_types:
            raise unknown_choice(f"{self.name} prediction_type", self.prediction_type, self.prediction_types)

    @abstractmethod
    def draw_times(
        self, n: int, like: Tensor, generator: torch.Generator | None = None
    ) -> Float[Tensor, " n"]:
        """Times to train at, on the device of ``like``, in its precision but at least float32.

        They are drawn on the generator's device: without one, from that device's global generator.
        """

    @abstractmethod
    def levels(self, time: Float[Tensor, "*S"]) -> Levels:
        """How much of the actions and of the noise is in x: alpha, sigma."""

    def noised(
        self, actions: Float[Tensor, "B T A"], noise: Float[Tensor, "B T A"], time: Float[Tensor, "*S"]
    ) -> Float[Tensor, "B T A"]:
        """x: the actions, noised to this time."""
        alpha, sigma = self.levels(_spread(time, actions))
        return alpha * actions + sigma * noise

    def target(
        self, actions: Float[Tensor, "B T A"], noise: Float[Tensor, "B T A"], time: Float[Tensor, "*S"]
    ) -> Float[Tensor, "B T A"]:
        """What the network is asked for, given x."""
        if self.prediction_type == "sample":
            return actions
        of_actions, of_noise = self._target_levels(*self.levels(_spread(time, actions)))
        return of_actions * actions + of_noise * noise

    def clean(
        self, x: Float[Tensor, "B T A"], output: Float[Tensor, "B T A"], time: Float[Tensor, "*S"]
    ) -> Float[Tensor, "B T A"]:
        """x0: the network's estimate of the clean actions; exact when its output is the `target`."""
        if self.prediction_type == "sample":
            return output
        of_noise, sigma, determinant = self._equations(_spread(time, x))
        return (of_noise * x - sigma * output) / determinant

    def clean_weights(self, time: Float[Tensor, "*S"]) -> tuple[Float[Tensor, "*S"], Float[Tensor, "*S"]]:
        """`clean` is ``of_x * x + of_output * output``: tables for inference, made once for all times.

        The two differ by rounding, which epsilon's first steps magnify: 1 / alpha is 2000 at step 99 of 100.
        """
        if self.prediction_type == "sample":
            return torch.zeros_like(time), torch.ones_like(time)
        of_noise, sigma, determinant = self._equations(time)
        return of_noise / determinant, -sigma / determinant

    def _equations(self, time: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """What solves x = alpha a + sigma n, output = p a + q n for a: q, sigma and alpha q - sigma p."""
        alpha, sigma = self.levels(time)
        of_actions, of_noise = self._target_levels(alpha, sigma)
        return of_noise, sigma, alpha * of_noise - sigma * of_actions

    def _target_levels(self, alpha: Tensor, sigma: Tensor) -> tuple[Tensor, Tensor]:
        """How much of the actions and of the noise is in the target."""
        match self.prediction_type:
            case "epsilon":
                return torch.zeros_like(alpha), torch.ones_like(alpha)
            case "v_prediction":
                return -sigma, alpha
            case _:  # velocity, dx/dt of the rectified flow
                return torch.ones_like(alpha), -torch.ones_like(alpha)


@dataclass(frozen=True)
class Diffusion(Process):
    """DDPM (Ho et al. 2020), in integer steps: -1 is clean, 0 nearly so, and T - 1 nearly noise.

    Alpha-bar comes from diffusers' scheduler of the same settings. ``v_prediction`` is Salimans & Ho 2022.

    Args:
        prediction_type: ``epsilon`` (the noise), ``v_prediction`` or ``sample`` (the actions).
        num_train_timesteps: T.
        beta_schedule: ``squaredcos_cap_v2`` (Nichol & Dhariwal 2021), ``linear`` or ``scaled_linear``.
        beta_start: first beta of the linear schedules.
        beta_end: last beta of the linear schedules.

    Raises:
        ConfigurationError: an unknown prediction type or schedule, or no steps.
    """

    name: ClassVar[str] = "ddpm"
    clean_time: ClassVar[float] = -1
    prediction_types: ClassVar[tuple[str, ...]] = ("epsilon", "v_prediction", "sample")
    num_train_timesteps: int
    beta_schedule: str
    beta_start: float
    beta_end: float
    _tables: dict[torch.device, Tensor] = field(default_factory=dict, init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.beta_schedule not in BETA_SCHEDULES:
            raise unknown_choice("beta_schedule", self.beta_schedule, BETA_SCHEDULES)
        if self.num_train_timesteps < 1:
            raise ConfigurationError(
                f"num_train_timesteps must be at least 1, but is {self.num_train_timesteps}"
            )

    def scheduler_settings(self) -> dict[str, Any]:
        """The arguments that all schedulers of diffusers share."""
        return {
            "num_train_timesteps": self.num_train_timesteps,
            "beta_schedule": self.beta_schedule,
            "beta_start": self.beta_start,
            "beta_end": self.beta_end,
            "prediction_type": "sample",
        }

    def draw_times(
        self, n: int, like: Tensor, generator: torch.Generator | None = None
    ) -> Float[Tensor, " n"]:
        """Steps, each with the same probability."""
        device = generator.device if generator else like.device
        steps = torch.randint(self.num_train_timesteps, (n,), generator=generator, device=device)
        return steps.to(like.device, _precision(like))

    def levels(self, time: Float[Tensor, "*S"]) -> Levels:
        """The square roots of alpha-bar and of its complement."""
        alpha_bar = self._alpha_bars(time.device)[time.long() + 1].to(time.dtype)
        return alpha_bar.sqrt(), (1 - alpha_bar).sqrt()

    def _alpha_bars(self, device: torch.device) -> Float[Tensor, " n_levels"]:
        """Of all steps, from the clean one on."""
        if device not in self._tables:
            from diffusers.schedulers.scheduling_ddpm import DDPMScheduler

            with torch.inference_mode(False):  # or training could not use it after an evaluation
                noisy = DDPMScheduler(**self.scheduler_settings()).alphas_cumprod
                self._tables[device] = torch.cat([torch.ones(1), noisy]).to(device)
        return self._tables[device]


@dataclass(frozen=True)
class Flow(Process):
    """Rectified flow (Liu et al. 2022): straight lines from noise at t = 0 to actions at t = 1.

    openpi counts the other way round: its t is 1 - t here, its velocity the negative.

    Args:
        prediction_type: ``velocity`` (actions - noise) or ``sample`` (the actions).
        time_distribution: of the times to train at. ``uniform``; ``beta``, pi0's (Black et al. 2024), which
            prefers noisy times: 0.999 * (1 - u) with u ~ Beta(1.5, 1); ``logit_normal`` (Esser et al. 2024),
            the sigmoid of a standard normal, which prefers the middle.

    Raises:
        ConfigurationError: an unknown prediction type or distribution.
    """

    name: ClassVar[str] = "flow"
    clean_time: ClassVar[float] = 1
    prediction_types: ClassVar[tuple[str, ...]] = ("velocity", "sample")
    time_distribution: str

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.time_distribution not in TIME_DISTRIBUTIONS:
            raise unknown_choice("time_distribution", self.time_distribution, TIME_DISTRIBUTIONS)

    def draw_times(
        self, n: int, like: Tensor, generator: torch.Generator | None = None
    ) -> Float[Tensor, " n"]:
        """Times of ``time_distribution``."""
        draw = torch.randn if self.time_distribution == "logit_normal" else torch.rand
        device = generator.device if generator else like.device
        drawn = draw(n, generator=generator, device=device, dtype=_precision(like)).to(like.device)
        match self.time_distribution:
            case "beta":
                return 0.999 * (1 - drawn ** (2 / 3))  # u = drawn^(1/1.5) inverts the distribution u^1.5
            case "logit_normal":
                return drawn.sigmoid()
            case _:
                return drawn

    def levels(self, time: Float[Tensor, "*S"]) -> Levels:
        """t and 1 - t."""
        return time, 1 - time


@dataclass(frozen=True)
class TwoStep(Process):
    """Two regressions, one upon the other: the minimum iterative policy (Pan et al. 2025, arXiv 2512.01809).

    The network predicts the actions from nothing at t = 0, and again from slightly noised actions at
    ``refine_time``; half of the times to train at are either. Neither pass of inference draws anything.

    Args:
        prediction_type: ``sample`` (the actions).
        refine_time: t of the second pass: x is t * actions + (1 - t) * noise [0..1].

    Raises:
        ConfigurationError: an unknown prediction type, or a time outside (0, 1).
    """

    name: ClassVar[str] = "two_step"
    clean_time: ClassVar[float] = 1
    prediction_types: ClassVar[tuple[str, ...]] = ("sample",)
    refine_time: float = 0.9

    def __post_init__(self) -> None:
        super().__post_init__()
        if not 0 < self.refine_time < 1:
            raise ConfigurationError(f"refine_time must be between 0 and 1, but is {self.refine_time}")

    def draw_times(
        self, n: int, like: Tensor, generator: torch.Generator | None = None
    ) -> Float[Tensor, " n"]:
        """0 or ``refine_time``, each with the same probability."""
        device = generator.device if generator else like.device
        second = torch.randint(2, (n,), generator=generator, device=device)
        return self.refine_time * second.to(like.device, _precision(like))

    def levels(self, time: Float[Tensor, "*S"]) -> Levels:
        """t and 1 - t, but nothing at all at t = 0: the first prediction sees no noise."""
        return time, torch.where(time > 0, 1 - time, 0)


def _precision(like: Tensor) -> torch.dtype:
    return torch.promote_types(like.dtype, torch.float32)


def _spread(time: Tensor, x: Tensor) -> Tensor:
    """Times with as many dimensions as x, so that they broadcast over what they have no dimension for."""
    return time.reshape(*time.shape, *(1,) * (x.ndim - time.ndim)) if time.ndim else time


PROCESSES: dict[str, type[Process]] = {each.name: each for each in (Flow, Diffusion, TwoStep)}
"""The processes. What is listed here can be asked for as ``objective``."""
