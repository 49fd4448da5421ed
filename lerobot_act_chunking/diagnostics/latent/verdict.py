"""The answer in words: posterior collapse, prior hole, or healthy?"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from lerobot_act_chunking.diagnostics.core.report import Judgement
from lerobot_act_chunking.diagnostics.latent.figures import SMALLEST_GROUP, Group, Health, PriorCheck
from lerobot_act_chunking.diagnostics.latent.settings import Thresholds

HEALTHY, COLLAPSE, HOLE = "healthy", "posterior collapse", "prior hole"


@dataclass(frozen=True)
class LatentJudgement(Judgement):
    """The answer; the first reason is the diagnosis's.

    Attributes:
        diagnosis: ``posterior collapse``, ``prior hole`` or ``healthy``.
    """

    diagnosis: str


@dataclass(frozen=True)
class Measurements:
    """What the answer rests on.

    Attributes:
        config: of the policy.
        health: of its posteriors.
        errors: mean absolute error [normalised units] by where the style is from.
        acting: the prior that the policy samples, or would, if told to.
        groups: of the demonstrations.
        is_fitted: whether the prior was fitted after training.
    """

    config: Any
    health: Health
    errors: Mapping[str, float]
    acting: PriorCheck
    groups: list[Group]
    is_fitted: bool

    @property
    def information(self) -> float:
        """By which share the error rises with another demonstration's style."""
        return self.errors["shuffled"] / max(self.errors["posterior"], 1e-12) - 1


def judge(measured: Measurements, thresholds: Thresholds) -> LatentJudgement:
    """Diagnose a latent.

    A collapsed latent is a warning: the policy acts as one without a latent, which may be all that the task
    takes. A hole is a failure only if the policy acts by sampling.
    """
    poor = _poor_groups(measured, thresholds)
    collapse = _collapse(measured, thresholds)
    if collapse:
        reasons = [f"{' and '.join(collapse)}: {_listen(measured)}", *poor]
        return LatentJudgement("warn", reasons, COLLAPSE)
    hole, remedy = _hole(measured, thresholds), _fill(measured)
    if not hole and _of_situations(measured, thresholds):
        hole = [
            f"{measured.health.by_place:.0%} of what tells styles apart follows from the place in the "
            "episode, which this prior does not see: it samples styles of other situations"
        ]
        remedy = "train with --policy.latent_type=conditional, or act with --policy.z_inference=mode"
    if hole:
        samples = measured.config.z_inference == "sample"
        verdict = "fail" if samples else "warn"
        kept = (
            [] if samples else ["it acts with the mode of the prior (z_inference=mode) and samples nothing"]
        )
        return LatentJudgement(verdict, [f"{' and '.join(hole)}: {remedy}", *kept, *poor], HOLE)
    found = (
        f"the latent tells {measured.health.kl:.2g} nats, another demonstration's style raises the error by "
        f"{measured.information:.0%}, and {1 - measured.acting.outside:.0%} of the prior's samples are like "
        "demonstrated ones"
    )
    return LatentJudgement("warn" if poor else "pass", [found, *poor], HEALTHY)


def _collapse(measured: Measurements, thresholds: Thresholds) -> list[str]:
    found = []
    if not measured.health.active_units:
        largest = max(measured.health.mean_variance)
        found.append(f"no dimension of the latent differs between demonstrations (variance {largest:.1g})")
    if measured.information < thresholds.information:
        change = max(measured.information, 0.0)
        found.append(f"another demonstration's style changes the error by {change:.1%} only")
    return found


def _listen(measured: Measurements) -> str:
    weight = measured.config.kl_weight
    return (
        "the policy acts as one without a latent, which is fine if there is one way to do the task; else "
        f"lower --policy.kl_weight (now {weight:g}, try {weight / 10:g}) or give --policy.free_bits=0.05"
    )


def _hole(measured: Measurements, thresholds: Thresholds) -> list[str]:
    acting, found = measured.acting, []
    if acting.outside > thresholds.outside:
        found.append(f"{acting.outside:.0%} of the prior's samples are unlike every demonstrated style")
    if acting.starved > thresholds.starved:
        found.append(f"it hardly samples styles that {acting.starved:.0%} of the demonstrations have")
    return found


def _of_situations(measured: Measurements, thresholds: Thresholds) -> bool:
    sees = measured.config.latent_type == "conditional"
    return not sees and measured.health.by_place > thresholds.by_place


def _fill(measured: Measurements) -> str:
    kind = measured.config.latent_type
    if kind == "gaussian" and not measured.is_fitted:
        return (
            "fit the prior to the demonstrations (act-chunking fit-prior, no training), or train with "
            "--policy.latent_type=mixture or categorical"
        )
    if kind == "gaussian":
        return "the fitted density does not follow these demonstrations: fit it to them again"
    if kind == "categorical":
        return "train for longer: codes are in use that later ones replaced"
    return "train for longer, or use --policy.latent_type=gaussian and act-chunking fit-prior"


def _poor_groups(measured: Measurements, thresholds: Thresholds) -> list[str]:
    """Groups that not even their own styles reconstruct: not the latent's fault but the decoder's."""
    mean = measured.errors["posterior"]
    poor = [
        f"{number} ({group.share:.0%} of the demonstrations, {group.error / mean:.1f} times the usual error)"
        for number, group in enumerate(measured.groups, 1)
        if group.share >= SMALLEST_GROUP
        and group.error is not None
        and group.error > thresholds.poor_group * mean
    ]
    if not poor:
        return []
    return [f"the decoder has not learned group {', '.join(poor)}: train for longer, or show it more often"]
