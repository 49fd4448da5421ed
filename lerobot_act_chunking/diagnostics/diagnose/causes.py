"""Causes that can be seen without changing anything, the certain ones first; each a small pure test."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from lerobot_act_chunking.diagnostics.core.normalisers import Spread
from lerobot_act_chunking.diagnostics.diagnose.demonstrations import Knowledge
from lerobot_act_chunking.diagnostics.diagnose.records import Record

LEVEL = 0.05
HARDLY_MOVES = 0.05
"""Range of the commands in an episode, as a share of the demonstrations', of who holds still."""
HALF = 0.5
DARKER = 0.05
"""Difference of an image's mean colour from the recorded one, in [0, 1], that shows."""
HARDLY = 0.8
"""Of the mean action's error: what has learned is well below."""
SHAKY = 0.08
"""Share of the mean action's error on its own demonstrations that a trained policy stays below."""
OVERFITTED = 3.0
"""Error on other demonstrations, as a multiple of that on its own, of who has learned them by heart."""
WIDE = 2.0
"""Distance of two chunks, as a multiple of their error, from which they are of different ways."""
CHANNELS = 3
CLOSER = 0.5
"""Share of the distance that another order of the channels must leave, to be the right one."""


@dataclass(frozen=True)
class Finding:
    """One cause that was looked for.

    Attributes:
        name: of the cause.
        found: whether it is there; None where it cannot be told.
        evidence: in one sentence.
        repair: what to do about it, if it is there.
        certain: whether it explains failures by itself, without an intervention.
    """

    name: str
    found: bool | None
    evidence: str
    repair: str = ""
    certain: bool = False


def inert_statistics(spreads: Mapping[str, Spread | None]) -> Finding:
    """Whether the processors normalise at all."""
    missing = [key for key, each in spreads.items() if each is None]
    inert = [key for key, each in spreads.items() if each is not None and each.is_inert]
    if not spreads:
        return Finding("inert statistics", False, "This policy normalises nothing by its configuration.")
    if not missing and not inert:
        return Finding("inert statistics", False, f"{len(spreads)} features are normalised.")
    words = [f"no statistics of {', '.join(missing)}"] if missing else []
    words += [f"mean 0 and spread 1 of {', '.join(inert)}"] if inert else []
    return Finding(
        "inert statistics",
        True,
        f"The processors hold {' and '.join(words)}: they pass on raw units, which the network never saw.",
        "make the processors anew from the training data: make_pre_post_processors(config, "
        "dataset_stats=dataset.meta.stats), then save_pretrained into the checkpoint's folder",
        certain=True,
    )


def other_statistics(differ: Sequence[str] | None, far: Mapping[str, float]) -> Finding:
    """Whether the processors hold statistics of other data.

    Args:
        differ: keys whose statistics are not those of the demonstrations; None without demonstrations.
        far: keys whose observations lie far from the statistics, with their distance [standard deviations].
    """
    name = "wrong statistics"
    if not differ and not far:
        seen = "" if differ is None else "they are those of the demonstrations, and "
        return Finding(name, False, f"Statistics: {seen}observations lie within them.")
    words = [f"{', '.join(differ)} differ from the demonstrations'"] if differ else []
    words += [f"{key} is {z:.0f} standard deviations off where episodes start" for key, z in far.items()]
    return Finding(
        name,
        True,
        f"The statistics in the processors are of other data: {'; '.join(words)}.",
        "put the statistics of the training data into the processors, or train on data of this environment",
        certain=differ is None,
    )


def initial_weights(sentence: str | None) -> Finding:
    """Whether the weights are those that every network begins with.

    Args:
        sentence: that they are, if they are.
    """
    if sentence is None:
        return Finding("untrained", False, "The weights are not the initial ones.")
    evidence, repair = (
        "All weights are still the initial ones.",
        "give a checkpoint of a finished lerobot-train",
    )
    return Finding("untrained", True, evidence, repair, certain=True)


def hardly_learned(own: Knowledge | None) -> Finding:
    """Whether the demonstrations of its training are known better than by their mean action.

    Args:
        own: how well they are known; None if they are not here, or if what it is given is not normalised.
    """
    name = "hardly learned"
    if own is None:
        return Finding(name, None, "Nothing to compare the policy's chunks with.")
    told = (
        f"At once off by {own.soon:.2g} from demonstrators, the mean action by {own.mean_action:.2g} [std]."
    )
    if own.soon <= HARDLY * own.mean_action:
        return Finding(name, False, told)
    return Finding(name, True, told, "train for longer, and look at the training's loss", certain=True)


def weak_training(own: Knowledge | None, other: Knowledge | None) -> Finding:
    """Whether the demonstrations of its training are badly known, or only these are well known.

    The first tenth of a chunk counts: what comes later may follow from nothing that was observed. How well
    demonstrations can be known differs: who rests for longer or shorter surprises everybody. So a policy is
    only called badly trained if copying the nearest other demonstration would be better, too.
    """
    name = "under-training or too little data"
    if own is None:
        return Finding(name, None, "The demonstrations of the training are not here.")
    share = own.soon / own.mean_action
    told = f"On its own demonstrations it is at once off by {100 * share:.1f} % of the mean action's error"
    if own.nearest is not None:
        told += f", the nearest other demonstration by {100 * own.nearest / own.mean_action:.1f} %"
    if share > SHAKY:
        if own.nearest is None:
            return Finding(name, None, f"{told}. Whether that is much, images alone do not tell.")
        if own.soon > own.nearest:
            return Finding(
                name, True, f"{told}.", "train for longer: lerobot-train --resume=true --steps=..."
            )
    if other is not None and other.soon > OVERFITTED * own.soon and other.soon > SHAKY * other.mean_action:
        held = f"{told}, on others by {100 * other.soon / other.mean_action:.1f} %."
        return Finding(name, True, held, "record more demonstrations, or train a smaller network")
    return Finding(name, False, f"{told}.")


def modes_and_boundaries(own: Knowledge | None) -> Finding:
    """How far chunks differ that are drawn at one observation, or that follow each other; a hint, no verdict.

    Args:
        own: how well some demonstrations are known.
    """
    name = "draws and boundaries"
    if own is None:
        return Finding(name, None, "Without demonstrations there is nothing to draw chunks at.")
    told = f"Where demonstrators were, two draws differ by {own.scatter:.2g} [std]"
    if own.disagreement is not None:
        told += f", a chunk and the next one by {own.disagreement:.2g}"
    worst = max(own.scatter, own.disagreement or 0.0)
    return Finding(name, worst > WIDE * own.error, f"{told}; the error is {own.error:.2g}.")


def holds_still(records: Sequence[Record], spans: np.ndarray) -> Finding:
    """Whether failing episodes command hardly any change, and stand still for most of their time.

    Args:
        records: failing episodes.
        spans: range (A,) of each number of the action in the demonstrations; 0 where it never changes.
    """
    moving = spans > 0
    if not records or not moving.any():
        return Finding("holds still", None, "No range of the commands is known to compare with.")
    reach = [float((np.ptp(each.commands, axis=0)[moving] / spans[moving]).max()) for each in records]
    told = f"In the median failing episode commands cover {100 * np.median(reach):.0f} % of the usual range."
    still = np.median([each.episode.still_s / (each.episode.length * each.dt) for each in records])
    found = bool(np.median(reach) < HARDLY_MOVES and still > HALF)
    repair = "the policy commands hardly any motion: look at its training loss, and train it anew"
    return Finding("holds still", found, told, repair if found else "", certain=found)


def stalls(records: Sequence[Record]) -> Finding:
    """Whether failing episodes end in standing still, and when that begins."""
    if not records:
        return Finding("stall", None, "No episode failed.")
    still = [each for each in records if each.episode.stalled]
    told = f"{len(still)} of {len(records)} failing episodes end standing still"
    if not still:
        return Finding("stall", False, f"{told}.")
    begins = np.median([each.episode.length * each.dt - each.episode.still_s for each in still])
    return Finding(
        "stall", len(still) > HALF * len(records), f"{told}, the median one from {begins:.1f} s on."
    )


def control_rate(trained: float | None, runs: float) -> Finding:
    """Whether the environment runs at the rate of the demonstrations [control steps per second]."""
    if trained is None:
        return Finding("control rate", None, "The rate of the training data is not known.")
    wrong = abs(trained - runs) > 0.01 * runs
    told = f"Demonstrations at {trained:g} Hz, the environment at {runs:g} Hz."
    repair = f"run it at {trained:g} control steps a second, as by --env.fps={trained:g}" if wrong else ""
    return Finding("control rate", wrong, told, repair, certain=wrong)


def images(
    declared: Mapping[str, Sequence[int]],
    observed: Mapping[str, np.ndarray],
    recorded: Mapping[str, np.ndarray],
) -> Finding:
    """Whether images look as the recorded ones: their size, their range and the order of their channels.

    Args:
        declared: shape (3, height, width) of each camera's image, as the policy was trained.
        observed: images (N, 3, height, width) in [0, 1], as the policy is given them.
        recorded: mean of each channel (3,) in [0, 1] in the training data; of some cameras.
    """
    name = "images"
    if not declared:
        return Finding(name, False, "The policy sees no images.")
    wrong = []
    for key, seen in observed.items():
        if tuple(seen.shape[1:]) != tuple(declared[key]):
            wrong.append(
                f"{key} has shape {tuple(seen.shape[1:])}, in training it had {tuple(declared[key])}"
            )
        if seen.min() < 0 or seen.max() > 1:
            wrong.append(f"{key} lies in {seen.min():.3g} to {seen.max():.3g}, not in 0 to 1")
        mean = recorded.get(key)
        if mean is None or len(mean) != CHANNELS or seen.shape[1] != CHANNELS:
            continue
        here = seen.mean((0, 2, 3))
        straight, swapped = np.abs(here - mean).max(), np.abs(here[::-1] - mean).max()
        if swapped < CLOSER * straight and straight > DARKER:
            wrong.append(f"red and blue of {key} are swapped")
        elif min(straight, swapped) > 2 * DARKER + 0.1:
            wrong.append(f"{key} is {straight:.2g} brighter or darker than the recorded images")
    if wrong:
        repair = "render images as the recorded ones: size, channel order, light (--env options)"
        return Finding(
            name, True, f"Images differ from the training's: {'; '.join(wrong)}.", repair, certain=True
        )
    return Finding(name, False, "Images have the size, range and colours of the training's.")
