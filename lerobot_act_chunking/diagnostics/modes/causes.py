"""Why a policy does not take the demonstrated ways, and what repairs it; pure: it knows counts alone."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from lerobot_act_chunking.diagnostics.modes.frequencies import Frequencies
from lerobot_act_chunking.diagnostics.modes.inside import CodeModes, Inside, LatentModes
from lerobot_act_chunking.diagnostics.modes.settings import Thresholds
from lerobot_act_chunking.diagnostics.modes.switching import Switching

NONE, UNKNOWN = "none", "none of these"
COLLAPSED, HOLE, UNDERTRAINED = "collapsed posterior", "hole in the prior", "under-trained decoder"
BLENDED, ONE_WAY = "blended modes", "nothing is sampled"
OVERLONG, SWITCHED = "overlong ensemble across modes", "mode switched within episodes"
BLENDING = ("ensemble", "crossfade", "adaptive")
"""Ways of executing chunks that average what several of them say."""


@dataclass(frozen=True)
class Cause:
    """Why.

    Attributes:
        name: one of the names above.
        because: what shows it, as a clause.
        fix: what to do, with the option or command; empty where nothing is to be repaired.
    """

    name: str
    because: str = ""
    fix: str = ""


@dataclass(frozen=True)
class Evidence:
    """What the answer rests on.

    Attributes:
        config: of the policy.
        episodes: the ways that they went.
        chunks: the ways of the chunks that were sampled at their starts; None if that is not known.
        deterministic: whether all samples of a start are the same chunk.
        switching: of the way within episodes; None if that is not known.
        inside: of a policy with a latent or with codes.
        untold: whether there are chunks, and the demonstrated ones do not tell the ways apart.
    """

    config: Any
    episodes: Frequencies
    chunks: Frequencies | None = None
    deterministic: bool = False
    switching: Switching | None = None
    inside: Inside | None = None
    untold: bool = False


def find_cause(evidence: Evidence, thresholds: Thresholds) -> Cause:
    """The first cause, from what is sampled to how it is executed, that the evidence shows.

    Chunks that are wrong have one also where the episodes are right.
    """
    sampled_right = evidence.chunks is None or evidence.chunks.good(thresholds)
    if evidence.episodes.good(thresholds) and sampled_right:
        return Cause(NONE)
    if evidence.untold:
        return Cause(
            UNKNOWN,
            "the ways part later than the first chunk ends, or do so too little to be told apart in it",
            "act-chunking diagnose, for what makes episodes fail",
        )
    if evidence.chunks is None:
        return Cause(
            UNKNOWN, "the chunks could not be looked at", "give the demonstrations by --dataset=FOLDER"
        )
    found = _executed if sampled_right else _sampled
    every = (*found(evidence, evidence.chunks, thresholds), _unknown(evidence.chunks))
    return every[0]


def _sampled(evidence: Evidence, chunks: Frequencies, thresholds: Thresholds) -> Iterator[Cause]:
    """What is wrong with the chunks themselves."""
    if isinstance(evidence.inside, LatentModes):
        yield from _of_latent(evidence, evidence.inside, thresholds)
    if isinstance(evidence.inside, CodeModes):
        yield from _of_codes(evidence.inside, thresholds)
    invalid = chunks.invalid_share > thresholds.invalid
    if evidence.deterministic:
        told = "the policy always predicts the same chunk, "
        if invalid:
            yield Cause(BLENDED, f"{told}and it lies between the demonstrated ways", _SAMPLE)
        else:
            yield Cause(ONE_WAY, f"{told}of one way", _start_sampling(evidence.config))
    elif invalid:
        because = f"{chunks.invalid_share:.0%} of the sampled chunks go no demonstrated way"
        yield Cause(BLENDED, because, _unblend(evidence.config))
    missing = _named(chunks.missing(thresholds))
    yield Cause(UNDERTRAINED, f"hardly any sampled chunk goes {missing}", _learn_rare(evidence.config))


def _of_latent(evidence: Evidence, latent: LatentModes, thresholds: Thresholds) -> Iterator[Cause]:
    config = evidence.config
    if latent.kl < thresholds.collapsed or not latent.active_units:
        weight = config.kl_weight
        yield Cause(
            COLLAPSED,
            f"the latent says {latent.kl:.2g} nats of a demonstration: decoding does not depend on it",
            f"train with --policy.kl_weight={weight / 100:g} (now {weight:g}), or --policy.free_bits=0.05",
        )
    bad = _poor(latent.reconstructed, thresholds)
    if bad:
        because = f"not even their own styles bring demonstrations back to {_named(bad)}"
        yield Cause(UNDERTRAINED, because, _learn_rare(config))
    hole = latent.posterior.good(thresholds) and not latent.prior.good(thresholds)
    if hole and not evidence.deterministic:  # else acting does not sample the prior
        found = f"chunks from the prior: {_told(latent.prior)}, from other demonstrations' styles: "
        yield Cause(HOLE, f"{found}{_told(latent.posterior)}", _fill(config, latent))


def _fill(config: Any, latent: LatentModes) -> str:
    if config.latent_type != "gaussian":
        return "--policy.latent_type=gaussian and act-chunking fit-prior, or train for longer"
    if latent.fitted:
        return "the fitted density does not follow the demonstrations: train for longer, and fit it again"
    return (
        "act-chunking fit-prior CHECKPOINT DATASET --out FOLDER (no training; --component-weights uniform: "
        "all components equally often)"
    )


def _of_codes(codes: CodeModes, thresholds: Thresholds) -> Iterator[Cause]:
    bad = _poor(codes.reconstructed, thresholds)
    if bad:
        yield Cause(
            UNDERTRAINED,
            f"the codes of demonstrations do not bring them back to {_named(bad)}",
            "a larger codebook (--policy.vqvae_n_embed), more --policy.n_vqvae_training_steps, or "
            "--policy.balance_modes=labels",
        )


def _executed(evidence: Evidence, chunks: Frequencies, thresholds: Thresholds) -> Iterator[Cause]:
    """What becomes of chunks that are right."""
    switching, mode = evidence.switching, getattr(evidence.config, "execution", "open_loop")
    if switching is None or switching.share <= thresholds.switched:
        return
    because = f"the chunks are right, but those of {switching.share:.0%} of the episodes go different ways"
    if mode in BLENDING:
        fix = f"--policy.execution=open_loop in place of {mode}, or {_hold(evidence.config)}"
        yield Cause(OVERLONG, f"{because}, and execution={mode} averages them", fix)
    else:
        yield Cause(SWITCHED, because, f"{_hold(evidence.config)}, or a longer --policy.n_action_steps")


def _unknown(chunks: Frequencies) -> Cause:
    return Cause(
        UNKNOWN,
        f"the chunks at the starts are right ({_told(chunks)}), and the episodes leave their way later",
        "act-chunking smoothness and eval show what happens on the way",
    )


_SAMPLE = (
    "a policy that samples: --policy.type=diffusion_chunked or vqbet_chunked, or of act_chunked "
    "--policy.action_likelihood=gmm --policy.action_temperature=1"
)


def _start_sampling(config: Any) -> str:
    """How a policy that always takes what is likeliest can be let go."""
    if getattr(config, "use_vae", False):
        return "act with --policy.z_inference=sample, after act-chunking fit-prior"
    if getattr(config, "action_likelihood", "l1") not in ("l1", "l2"):
        return "act with --policy.action_temperature=1"
    return _SAMPLE


def _unblend(config: Any) -> str:
    if getattr(config, "action_likelihood", None) in ("laplace", "gaussian", "categorical"):
        return (
            "each action is sampled on its own: --policy.action_likelihood=gmm decides for whole chunks, and "
            "so does a latent (--policy.use_vae=true)"
        )
    return "train for longer, or a larger network"


def _learn_rare(config: Any) -> str:
    top_p = getattr(config, "top_p", 1)
    limited = f"--policy.top_p=1 (now {top_p:g}, which leaves out what is rarer), then " if top_p < 1 else ""
    if getattr(config, "balance_modes", "none") == "none":
        return f"{limited}train with --policy.balance_modes=labels (or clusters), or record more of it"
    return f"{limited}train for longer, or record more of it"


def _hold(config: Any) -> str:
    """How a policy keeps to one way for an episode."""
    if getattr(config, "use_vae", False):
        return "--policy.z_hold=episode keeps the style"
    if hasattr(config, "code_hold"):
        return "--policy.code_hold=episode keeps the draw"
    if hasattr(config, "warm_start"):
        return "--policy.warm_start=noise_hold keeps the noise"
    return "--policy.execution=coherence keeps to the plan"


def _poor(shares: list[float | None], thresholds: Thresholds) -> list[int]:
    return [
        mode for mode, share in enumerate(shares) if share is not None and share < thresholds.reconstructed
    ]


def _told(found: Frequencies) -> str:
    """Shares of the ways in per cent, as 66/6/0 and 28 % invalid."""
    shares = "/".join(f"{100 * share:.0f}" for share in found.shares)
    return f"{shares} % and {100 * found.invalid_share:.0f} % invalid"


def _named(modes: list[int]) -> str:
    return f"mode {' and '.join(map(str, modes))}"
