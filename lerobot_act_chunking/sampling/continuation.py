"""Real-time chunking: a new chunk that goes on where the chunk under way will be when it takes over."""

from typing import Literal, get_args

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from lerobot_act_chunking.errors import ConfigurationError, unknown_choice
from lerobot_act_chunking.sampling.solvers import Denoise

PrefixSchedule = Literal["linear", "exp", "ones", "zeros"]
Jacobian = Literal["exact", "identity"]


def prefix_weights(
    n_frozen: int, blend_end: int, horizon: int, schedule: PrefixSchedule
) -> Float[Tensor, " horizon"]:
    """How much a new chunk is held to the plan at each of its steps (Black et al. 2025, eq. 5).

    1 for the steps that will have passed when the chunk is ready, 0 from ``blend_end`` on, and in between:

    ==========  =======================================================
    linear      falling linearly
    exp         falling faster: c (e^c - 1) / (e - 1) of the linear c
    ones        1: held to all of the plan
    zeros       0: held to the frozen steps alone
    ==========  =======================================================

    Args:
        n_frozen: steps that the computation of the chunk will take.
        blend_end: step at which the plan stops to count; a plan that ends before the computation freezes
            fewer steps.
        horizon: number of steps.
        schedule: one of the above.

    Raises:
        ConfigurationError: unknown schedule.
    """
    if schedule not in get_args(PrefixSchedule):
        raise unknown_choice("prefix_attention_schedule", schedule, get_args(PrefixSchedule))
    end = min(blend_end, horizon)
    start = min(n_frozen, end)
    steps = torch.arange(horizon)
    if schedule in ("ones", "zeros"):
        return (steps < (end if schedule == "ones" else start)).float()
    falling = ((end - steps) / (end - start + 1)).clamp(0, 1)
    return falling * falling.expm1() / torch.ones(()).expm1() if schedule == "exp" else falling


def continued(
    denoise: Denoise,
    alphas: Float[Tensor, " n"],
    sigmas: Float[Tensor, " n"],
    plan: Float[Tensor, "B T A"],
    weights: Float[Tensor, "#B T"],
    *,
    vjp: Jacobian,
    max_weight: float,
) -> Denoise:
    """Guide a denoiser towards chunks that continue a plan (real-time chunking, arXiv 2506.07339, eq. 2-5).

    Let y be the plan, W the weights, x = alpha a + sigma e, and f(x) the network's estimate of a.
    Pseudoinverse guidance (Song et al. 2023) takes a to be Gaussian around f with the variance it has if
    actions are standard normal, r^2 = sigma^2 / (alpha^2 + sigma^2), so that grad log p(y | x) = J' W (y - f)
    / r^2, J = df/dx. By Tweedie's formula f then becomes f + sigma^2 / alpha times that, which is f + sigma
    w J' W (y - f) with w = (alpha^2 + sigma^2) / (alpha sigma). Flow has alpha = t, sigma = 1 - t: the
    velocity, (f - x) / sigma, changes by w J' W (y - f), eq. 2, where the authors bound w. Any other process
    is flow with x divided by alpha + sigma, under which sigma J, and so this formula, stays as it is.

    LeRobot's RTCProcessor puts the identity in place of flow's J, here I / (alpha + sigma), which saves the
    backward pass. For an ideal network J is alpha / sigma^2 times the covariance of a given x, so that the
    exact product moves what the network is unsure of, and with it the steps that depend on it, but hardly a
    chunk that the observation decides; the identity holds any chunk to the plan. With either, the errors of
    f at neighbouring steps count as if they were independent, which overdoes it for smooth motions.

    Without a plan (all weights zero) ``denoise`` itself is returned. Works for callers in inference mode;
    gradients do not reach beyond it. Clipping belongs around it: inside, it would cut J.

    Args:
        denoise: gives the clean actions (B, T, A) for x (B, T, A) at evaluation i; any clipping excluded.
        alphas: the share of the actions in x at each evaluation.
        sigmas: the share of the noise.
        plan: what the chunk should continue, at the predicted steps; any value where the weight is zero.
        weights: one row for all environments, or one for each; zero rows leave an environment as it is.
        vjp: with the network's Jacobian, or with the identity.
        max_weight: bound of w; the paper has 5, LeRobot 10.

    Raises:
        ConfigurationError: unknown ``vjp``, or a bound that is not positive.
    """
    if vjp not in get_args(Jacobian):
        raise unknown_choice("rtc_vjp", vjp, get_args(Jacobian))
    if not max_weight > 0:
        raise ConfigurationError(f"max_guidance_weight={max_weight} must be positive")
    if not weights.any():
        return denoise
    strengths = guidance_strengths(alphas, sigmas, max_weight)
    if vjp == "identity":
        strengths = (strengths / (alphas + sigmas)).nan_to_num()
    strengths = strengths.tolist()
    held_to = weights.unsqueeze(-1).to(plan)

    def guided_by_identity(x: Float[Tensor, "B T A"], i: int) -> Float[Tensor, "B T A"]:
        clean = denoise(x, i)
        return clean + strengths[i] * (held_to * (plan - clean))

    # Inference mode would make the product zero without a word; outside of it, without gradients, tensors
    # that were made in it may be captured by the denoiser.
    @torch.inference_mode(False)
    @torch.no_grad()
    def guided(x: Float[Tensor, "B T A"], i: int) -> Float[Tensor, "B T A"]:
        clean, pull_back, *_ = torch.func.vjp(lambda x: denoise(x, i), x)
        (correction,) = pull_back(held_to * (plan - clean))
        return clean + strengths[i] * correction

    return guided if vjp == "exact" else guided_by_identity


def guidance_strengths(
    alphas: Float[Tensor, " n"], sigmas: Float[Tensor, " n"], max_weight: float
) -> Float[Tensor, " n"]:
    """Sigma times the bounded weight w of `continued`, in the limit where alpha or sigma is zero.

    Zero where both are: an estimate from nothing cannot be guided through x.
    """
    return torch.minimum(max_weight * sigmas, (alphas**2 + sigmas**2) / alphas).nan_to_num()


def held(denoise: Denoise, plan: Float[Tensor, "B T A"], frozen: Bool[Tensor, "#B T"]) -> Denoise:
    """For networks trained on it: where ``frozen``, they see the plan in place of x, and answer with it.

    Training-time real-time chunking (Black et al. 2025, arXiv 2512.05964); the network must be told the time
    of clean actions at these steps.
    """
    mask = frozen.unsqueeze(-1)

    def conditioned(x: Float[Tensor, "B T A"], i: int) -> Float[Tensor, "B T A"]:
        return torch.where(mask, plan, denoise(torch.where(mask, plan, x), i))

    return conditioned
