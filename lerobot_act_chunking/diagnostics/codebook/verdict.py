"""The answer in words: is the codebook in use, fine enough, and still that of the data?"""

from collections.abc import Mapping
from typing import Any

from lerobot_act_chunking.diagnostics.codebook.drift import Drift
from lerobot_act_chunking.diagnostics.codebook.losses import Losses
from lerobot_act_chunking.diagnostics.codebook.settings import Thresholds
from lerobot_act_chunking.diagnostics.codebook.subject import Subject
from lerobot_act_chunking.diagnostics.codebook.usage import Usage
from lerobot_act_chunking.diagnostics.core.report import Judgement
from lerobot_act_chunking.policies.vqbet_chunked.presets import preset_values
from lerobot_act_chunking.tokenizers.make import TOKENIZERS

FEWEST_CHUNKS = 256
SEVERITY = ("pass", "warn", "fail")

Finding = tuple[str, str]
"""How bad, one of `SEVERITY`, and why."""


def judge(
    subject: Subject, usage: Usage, losses: Losses, drift: Drift | None, thresholds: Thresholds
) -> Judgement:
    """Hold what was measured against the thresholds.

    Args:
        subject: the tokenizer.
        usage: of the codes.
        losses: of reconstruction.
        drift: against the training data, if there is other data.
        thresholds: when to worry.
    """
    if usage.chunks < FEWEST_CHUNKS:
        return Judgement(
            "inconclusive",
            [
                f"{usage.chunks} chunks are too few to judge a codebook by, it takes {FEWEST_CHUNKS}: "
                "give more demonstrations as --dataset"
            ],
        )
    settings = subject.settings
    findings = [*_dead(settings, usage, thresholds), *_coarse(settings, losses, thresholds)]
    if subject.unfinished is not None:
        findings.append(("fail", f"the tokenizer has learned for {subject.unfinished}: resume the training"))
    if drift is not None:
        findings += _drifted(drift, thresholds)
    if not findings:
        return Judgement("pass", [_nothing_wrong(losses, drift)])
    findings.sort(key=lambda finding: -SEVERITY.index(finding[0]))
    return Judgement(findings[0][0], [reason for _, reason in findings])


def _graded(value: float, limits: tuple[float, float]) -> str | None:
    if value <= limits[0]:
        return None
    return "fail" if value > limits[1] else "warn"


def _dead(settings: Mapping[str, Any], usage: Usage, thresholds: Thresholds) -> list[Finding]:
    """Codes that nobody uses; bins that are not learned may well be empty."""
    grade = _graded(usage.share_dead, thresholds.dead)
    if grade is None or not TOKENIZERS[settings["tokenizer"]].is_learned:
        return []
    level = max(range(len(usage.levels)), key=lambda i: len(usage.levels[i].dead))
    n_dead = len(usage.levels[level].dead)
    return [
        (
            grade,
            f"{n_dead} of the {usage.vocabulary} codes of level {level + 1} are never used: "
            f"{_revival(settings)}",
        )
    ]


def _revival(settings: Mapping[str, Any]) -> str:
    if settings["tokenizer"] == "fsq":
        return "take fewer values (smaller --policy.fsq_levels)"
    remedies = {"kmeans_iters": "place them by k-means", "dead_code_threshold": "revive them"}
    usual = preset_values("base", tokenizer=settings["tokenizer"], pretrained=False)
    missing = [
        f"{remedy} (--policy.{name}={usual[name]})" for name, remedy in remedies.items() if not settings[name]
    ]
    if missing:
        return f"{' and '.join(missing)}, or take --policy.tokenizer=fsq, whose codes cannot die"
    return (
        "train the tokenizer for longer, take fewer codes (--policy.vqvae_n_embed), or "
        "--policy.tokenizer=fsq, whose codes cannot die"
    )


def _coarse(settings: Mapping[str, Any], losses: Losses, thresholds: Thresholds) -> list[Finding]:
    findings = []
    grade = _graded(losses.lost_variance, thresholds.lost_variance)
    if grade is not None:
        message = f"the codes lose {losses.lost_variance:.0%} of what varies in the actions"
        findings.append(
            (grade, f"{message}, which the policy's offset has to make up for: {_finer(settings)}")
        )
    lost = [
        loss for loss in losses.dimensions if (loss.lost_variance or 0.0) > thresholds.lost_dimension_variance
    ]
    if lost:
        named = ", ".join(f"{loss.name} ({min(1.0, loss.lost_variance or 0.0):.0%} lost)" for loss in lost)
        message = f"they hardly tell {named}: ways that differ in these alone have the same codes"
        findings.append(("warn", message if grade else f"{message}; {_finer(settings)}"))
    return findings


def _finer(settings: Mapping[str, Any]) -> str:
    kind = TOKENIZERS[settings["tokenizer"]]
    training = ", longer training of the tokenizer" if kind.is_learned else ""
    return f"take {kind.finer}{training}, or shorter chunks"


def _drifted(drift: Drift, thresholds: Thresholds) -> list[Finding]:
    findings = []
    expected = drift.expected or 0.0
    if drift.largest > expected + thresholds.distance:
        findings.append(
            (
                "warn",
                f"{drift.folder} uses other codes than the training data: Jensen-Shannon distance "
                f"{drift.largest:.2f}, where training episodes differ by {expected:.2f} among themselves",
            )
        )
    grade = _graded(drift.error_ratio, thresholds.error_ratio)
    if grade is not None:
        findings.append((grade, f"errors there are {drift.error_ratio:.1f} times those of the training data"))
    grade = _graded(drift.beyond, thresholds.beyond)
    if grade is not None:
        findings.append(
            (
                grade,
                f"{drift.beyond:.0%} of its chunks have errors that 99 % of the training chunks do not have",
            )
        )
    if findings:
        grade, reason = findings[-1]
        findings[-1] = (grade, f"{reason}; train the tokenizer and the policy on both")
    return findings


def _nothing_wrong(losses: Losses, drift: Drift | None) -> str:
    message = f"the codes are in use and tell {1 - losses.lost_variance:.0%} of what varies"
    return message if drift is None else f"{message}; {drift.folder} fits them as the training data do"
