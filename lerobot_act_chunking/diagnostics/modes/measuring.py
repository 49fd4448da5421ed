"""From episodes and demonstrations to a `ModesReport`."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Int64

from lerobot_act_chunking.diagnostics.core.rollouts import Rollout
from lerobot_act_chunking.diagnostics.core.samples import Samples, read_samples
from lerobot_act_chunking.diagnostics.core.statistics import SuccessRate
from lerobot_act_chunking.diagnostics.modes.causes import UNKNOWN, Cause, Evidence, find_cause
from lerobot_act_chunking.diagnostics.modes.codes import measure_codes
from lerobot_act_chunking.diagnostics.modes.demonstrated import Demonstrated
from lerobot_act_chunking.diagnostics.modes.frequencies import Frequencies
from lerobot_act_chunking.diagnostics.modes.inside import Inside
from lerobot_act_chunking.diagnostics.modes.report import ModesReport, SampledChunks
from lerobot_act_chunking.diagnostics.modes.sampling import first_chunks, sample_chunks
from lerobot_act_chunking.diagnostics.modes.settings import Settings
from lerobot_act_chunking.diagnostics.modes.switching import Switching, find_switching
from lerobot_act_chunking.diagnostics.modes.verdict import judge
from lerobot_act_chunking.policies.loading import LoadedPolicy

MOST_STARTS = 200
UNTOLD = "The first {length} actions do not tell the demonstrated ways apart, so that no chunks are judged."
NO_DATA = "The demonstrations are not here, so that no chunks are judged: give --dataset=FOLDER."
NO_LABELS = "The dataset does not record which way each demonstration goes, so that no chunks are judged."


@dataclass(frozen=True)
class Ways:
    """Which ways there are, and which the episodes went.

    Attributes:
        source: of the proportions.
        told_by: the environment, or the commanded motion.
        proportions: of the demonstrations.
        modes: (n,) of the episodes.
    """

    source: str
    told_by: str
    proportions: tuple[float, ...]
    modes: Int64[np.ndarray, " n"]


@dataclass(frozen=True)
class Closer:
    """What a closer look at the policy shows; None, and a note, where it does not.

    Attributes:
        chunks: sampled at the starts.
        switching: of the way within episodes.
        inside: of a policy with a latent or with codes.
        note: what to know about it.
        untold: whether the chunks do not tell the ways apart.
    """

    chunks: SampledChunks | None = None
    switching: Switching | None = None
    inside: Inside | None = None
    note: str = ""
    untold: bool = False


def find_ways(
    settings: Settings, rollouts: Sequence[Rollout], demonstrated: Demonstrated | None
) -> Ways | None:
    """The ways of the episodes, in the environment's numbering where demonstrations have it, too.

    Returns:
        None if no ways are known: a single cluster is not several ways, nor are ways known without either
        demonstrations or shares that go with what the environment tells.
    """
    given = tuple(share / sum(settings.shares) for share in settings.shares)
    told = all(each.mode is not None for each in rollouts)
    modes = np.array([-1 if each.mode is None else each.mode for each in rollouts])
    recorded = demonstrated is not None and demonstrated.source == "recording"
    if told and (given or recorded):
        proportions = given or demonstrated.proportions  # pyright: ignore[reportOptionalMemberAccess]
        missing = max(int(modes.max()) + 1 - len(proportions), 0)
        source = "shares" if given else "recording"
        return Ways(source, "environment", (*proportions, *[0.0] * missing), modes)
    if demonstrated is None or len(demonstrated.proportions) < 2:
        return None
    fits = len(given) == len(demonstrated.proportions)
    by_motion = demonstrated.whole([each.commands for each in rollouts])
    return Ways(
        "shares" if fits else demonstrated.source,
        "motion",
        given if fits else demonstrated.proportions,
        by_motion,
    )


def measure(
    settings: Settings, loaded: LoadedPolicy, rollouts: Sequence[Rollout], demonstrated: Demonstrated | None
) -> ModesReport:
    """Count ways of episodes and chunks, look inside of the policy, and name the cause.

    Args:
        settings: what is asked.
        loaded: the policy.
        rollouts: its episodes, with their chunks.
        demonstrated: the demonstrations, if they are here.
    """
    config, thresholds = loaded.policy.config, settings.thresholds
    ways = find_ways(settings, rollouts, demonstrated)
    if ways is None:
        judgement = judge(None, None, Cause(UNKNOWN), thresholds)
        return ModesReport(judgement=judgement, requested=settings, policy_type=config.type)
    episodes = Frequencies.of(ways.modes, ways.proportions)
    if demonstrated is None:
        closer = Closer(note=NO_DATA)
    elif demonstrated.source == "clusters" and ways.told_by == "environment":
        closer = Closer(note=NO_LABELS)  # clusters have numbers of their own
    else:
        closer = _look_closer(settings, loaded, rollouts, demonstrated, ways.proportions)
    evidence = Evidence(
        config=config,
        episodes=episodes,
        chunks=closer.chunks and closer.chunks.frequencies,
        deterministic=closer.chunks is not None and closer.chunks.deterministic,
        switching=closer.switching,
        inside=closer.inside,
        untold=closer.untold,
    )
    return ModesReport(
        judgement=judge(episodes, evidence.chunks, find_cause(evidence, thresholds), thresholds),
        requested=settings,
        policy_type=config.type,
        dataset=demonstrated and demonstrated.folder,
        source=ways.source,
        told_by=ways.told_by,
        episodes=episodes,
        successes=_successes(rollouts, ways.modes, len(ways.proportions)),
        chunks=closer.chunks,
        switching=closer.switching,
        inside=closer.inside,
        notes=[closer.note] if closer.note else [],
    )


def _look_closer(
    settings: Settings,
    loaded: LoadedPolicy,
    rollouts: Sequence[Rollout],
    demonstrated: Demonstrated,
    proportions: tuple[float, ...],
) -> Closer:
    """The chunks at the starts and within episodes, and what a latent or codes have to do with them."""
    config, starts = loaded.policy.config, None
    if hasattr(loaded.policy, "predict_samples"):
        starts = read_samples(demonstrated.folder, config, MOST_STARTS, demonstrated.episodes.tolist())
        found = sample_chunks(loaded, starts, settings.samples)
        deterministic = settings.samples > 1 and found.shape[1] == 1
    else:
        found, deterministic = first_chunks(rollouts), False
    if found is None:
        return Closer(note="The policy does not show its chunks.")
    reference = demonstrated.reference(0, found.shape[2])
    if not reference.tells_apart:
        return Closer(note=UNTOLD.format(length=found.shape[2]), untold=True)
    scaled = demonstrated.scaled(found.reshape(-1, *found.shape[2:]))
    modes = reference.classify(scaled)
    chunks = SampledChunks(
        frequencies=Frequencies.of(modes, proportions),
        per_start=found.shape[1],
        deterministic=deterministic,
        chunks=scaled,
        modes=modes,
        reference=reference,
    )
    inside = None
    if starts is not None:
        inside = _look_inside(settings, loaded, starts, demonstrated, proportions)
    return Closer(chunks, find_switching(rollouts, demonstrated), inside)


def _look_inside(
    settings: Settings,
    loaded: LoadedPolicy,
    starts: Samples,
    demonstrated: Demonstrated,
    proportions: tuple[float, ...],
) -> Inside | None:
    """The latent or the codes, of policies that have them."""
    config, n = loaded.policy.config, len(proportions)
    modes = demonstrated.modes[np.searchsorted(demonstrated.episodes, starts.episode)]
    if getattr(config, "use_vae", False) and hasattr(loaded.policy, "style_lesson"):
        from lerobot_act_chunking.diagnostics.core.latents.subject import Subject
        from lerobot_act_chunking.diagnostics.modes.latents import measure_latent

        subject = Subject(settings.checkpoint, loaded)
        return measure_latent(subject, starts, demonstrated, modes, proportions, seed=settings.seed)
    if hasattr(loaded.policy, "tokenizer_phase"):
        return measure_codes(loaded, starts, demonstrated, modes, n)
    return None


def _successes(
    rollouts: Sequence[Rollout], modes: Int64[np.ndarray, " n"], n: int
) -> list[SuccessRate | None]:
    """Of the judged episodes of each way, and last of those that went none of them."""
    known = np.where((modes >= 0) & (modes < n), modes, n)
    outcomes = np.array([each.success for each in rollouts])
    told = np.array([each.instead is None for each in rollouts])
    parts = [outcomes[told & (known == mode)] for mode in range(n + 1)]
    return [SuccessRate(int(each.sum()), len(each)) if each.size else None for each in parts]
