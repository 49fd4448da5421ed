"""The answer in words: what should change before a policy learns from this dataset?"""

from collections.abc import Sequence

import numpy as np

from lerobot_act_chunking.diagnostics.core.noise_floor import listed
from lerobot_act_chunking.diagnostics.core.recording import Recording
from lerobot_act_chunking.diagnostics.core.report import Judgement
from lerobot_act_chunking.diagnostics.data.findings import Findings

FEWEST_SECONDS = 2.0
"""Length of the longest episode below which nothing can be said."""
RATE_OFF = 0.05
"""Share by which frames may be further apart than the dataset says."""
USELESS = 0.5
"""Share of an episode in which a camera that is blank or frozen makes it useless."""
FROZEN_S = 0.25
"""How long a picture must stay unchanged while the robot moves to be frozen."""
MOST_REPEATED = 0.1
"""Share of a camera's frames, or of the rows in motion, that may equal the one before."""
MOST_IDLE = 0.05
"""Share of the frames that may be idle at the start, or at the end."""
MOST_PAUSED = 0.01
"""Share of the frames that may be pauses."""
MOST_AT_AN_END = 0.1
"""Share of the frames that a joint may stand at exactly its least or greatest value."""
LONG_LAG_S = 0.3
"""Lag from which a chunk should be much longer than usual."""
UNEVEN_PACE = 2.0
"""Factor between fast and slow episodes from which the pace is uneven."""
INTO_A_COPY = (
    "(with its --repo_id and --root, and --new_repo_id for the copy: without, it is changed in place)"
)
DELETE = (
    "lerobot-edit-dataset --operation.type=delete_episodes --operation.episode_indices='{episodes}' "
    + INTO_A_COPY
)


def judge(recording: Recording, found: Findings) -> Judgement:
    """Hold a dataset against what policies can learn from.

    Args:
        recording: its sound episodes.
        found: what was measured of them.
    """
    failed = [*_broken(found), *_rate(recording, found), *_nothing_moves(found), *_useless_cameras(found)]
    longest = max(found.lengths_s)
    if not failed and longest < FEWEST_SECONDS:
        return Judgement(
            "inconclusive",
            [f"the longest episode lasts {longest:.2g} s, it takes {FEWEST_SECONDS:g} s to judge by"],
        )
    warned = [
        *_gaps(found),
        *_repeating_cameras(recording, found),
        *_idle(found),
        *_pauses(found),
        *_repeated_rows(recording, found),
        *_jumps(found),
        *_at_an_end(found),
        *_parked(found),
        *_lags(found),
        *_ways(found),
        *_pace(found),
    ]
    verdict = "fail" if failed else "warn" if warned else "pass"
    fine = f"{len(recording.episodes)} episodes without anything that should change before training"
    return Judgement(verdict, [*failed, *warned] or [fine])


def _broken(found: Findings) -> list[str]:
    if not found.broken:
        return []
    columns = ", ".join(sorted({column for each in found.broken.values() for column in each}))
    episodes = sorted(found.broken)
    return [
        f"{columns} is not finite in the episodes {_numbers(episodes)}: delete them: "
        f"{DELETE.format(episodes=episodes)}"
    ]


def _rate(recording: Recording, found: Findings) -> list[str]:
    """Clocks that count frames say nothing about the time that passed."""
    wrong = [each for each in found.clocks if abs(each.off(recording.fps)) > RATE_OFF]
    return [
        f"recorded at {each.rate_hz:.1f} frames a second by {each.column!r}, not at {recording.fps:g} as "
        f"meta/info.json says: played at {recording.fps:g} everything is {abs(each.off(recording.fps)):.0%} "
        f"too {'fast' if each.rate_hz < recording.fps else 'slow'}. Correct fps in meta/info.json and the "
        f"timestamps of a copy, or run the policy at {each.rate_hz:.1f} steps a second"
        for each in wrong
    ]


def _nothing_moves(found: Findings) -> list[str]:
    return (
        [] if found.actions.floor.moving else ["no action moves beyond its own noise: nothing can be learned"]
    )


def _useless_cameras(found: Findings) -> list[str]:
    reasons = []
    for camera in found.cameras:
        for what, bad in (
            ("shows nothing (one grey, such as black)", lambda each: each.blank >= USELESS),
            (
                "is frozen while the robot moves",
                lambda each: (
                    each.blank < USELESS and each.still >= USELESS and each.longest_still_s >= FROZEN_S
                ),
            ),
        ):
            episodes = [each.episode for each in camera.episodes if bad(each)]
            if len(episodes) == len(camera.episodes) > 1:
                reasons.append(
                    f"{camera.key!r} {what} in all episodes that were looked at: leave it out: "
                    "lerobot-edit-dataset --operation.type=remove_feature "
                    f"--operation.feature_names=\"['{camera.key}']\" {INTO_A_COPY}"
                )
            elif episodes:
                reasons.append(
                    f"{camera.key!r} {what} in the episodes {_numbers(episodes)} of {len(camera.episodes)} "
                    f"that were looked at: delete them: {DELETE.format(episodes=episodes)}"
                )
    return reasons


def _gaps(found: Findings) -> list[str]:
    reasons = [
        f"by {each.column!r} frames are missing in {each.gaps} places, the longest gap is "
        f"{each.longest_s:.2g} s: the recording computer did not keep up, use fewer cameras or a lower fps"
        for each in found.clocks
        if each.gaps
    ]
    return reasons + [
        f"{each.column!r} does not go on between {each.backwards} pairs of frames: write it anew"
        for each in found.clocks
        if each.backwards
    ]


def _repeating_cameras(recording: Recording, found: Findings) -> list[str]:
    return [
        f"{each.key!r} delivers {each.repeated:.0%} of its frames twice, and so some "
        f"{recording.fps * (1 - each.repeated):.0f} pictures a second and not {recording.fps:g}: a policy "
        f"can do with fewer predictions, ask act-chunking resolution {recording.folder}"
        for each in found.cameras
        if each.repeated >= MOST_REPEATED and all(part.blank < USELESS for part in each.episodes)
    ]


def _idle(found: Findings) -> list[str]:
    rests = found.actions.rests
    ends = [
        f"{share:.1%} at the {side} (median {median:.1f} s, longest {longest:.1f} s)"
        for side, share, median, longest in (
            ("start", rests.start_share, rests.start_median_s, rests.start_longest_s),
            ("end", rests.end_share, rests.end_median_s, rests.end_longest_s),
        )
        if share > MOST_IDLE
    ]
    if not ends:
        return []
    return [
        f"nothing is done in {' and '.join(ends)} of the frames: a policy learns to wait there, trim the "
        "episodes (the first and the last step in motion of each are in the file that --json writes)"
    ]


def _pauses(found: Findings) -> list[str]:
    rests = found.actions.rests
    if rests.pause_share <= MOST_PAUSED:
        return []
    return [
        f"demonstrators pause {rests.pauses_per_episode:.2g} times an episode, for up to "
        f"{rests.pause_longest_s:.1f} s: one observation does not say how long a pause has lasted, so let "
        f"chunks be longer than that: --policy.horizon_s={_horizon(rests.pause_longest_s)}"
    ]


def _repeated_rows(recording: Recording, found: Findings) -> list[str]:
    repeats = found.actions.repeats
    if repeats.in_motion <= MOST_REPEATED:
        return []
    return [
        f"{repeats.in_motion:.0%} of the actions in motion equal the one before: they are renewed some "
        f"{recording.fps * (1 - repeats.in_motion):.0f} times a second, so predict fewer: which "
        f"--policy.chunk_stride is fine enough says act-chunking resolution {recording.folder}"
    ]


def _jumps(found: Findings) -> list[str]:
    leaping = [each for each in found.actions.behaviours if each.moves and not each.hand and each.jumps]
    if not leaping:
        return []
    named = listed([f"{each.name} ({len(each.jumps)})" for each in leaping])
    episode, frame = leaping[0].jumps[0]
    return [
        f"joints jump by more than a fifth of their range within a frame: {named}, first in episode "
        f"{episode} after frame {frame}: look there, and delete episodes in which the robot did not "
        "really jump"
    ]


def _at_an_end(found: Findings) -> list[str]:
    ends = [
        f"{each.name} ({each.at_an_end[0]:.4g} in {each.at_an_end[1]:.0%})"
        for each in found.actions.behaviours
        if each.moves and not each.hand and each.at_an_end[1] >= MOST_AT_AN_END
    ]
    if not ends:
        return []
    return [
        f"joints stand at exactly their least or greatest value for long: {listed(ends)}: commands were cut "
        "off there, or the calibration is; calibrate the robot, and choose a task within its reach"
    ]


def _parked(found: Findings) -> list[str]:
    """Dimensions whose noise normalisation would blow up to the size of motion."""
    noisy = [each for each in found.actions.behaviours if each.kind == "noise"]
    if not noisy:
        return []
    floor = max(each.std for each in noisy)
    least = min((each.std for each in found.actions.behaviours if each.moves), default=np.inf)
    cure = (
        f"--policy.norm_std_floor={float(f'{1.05 * floor:.2g}'):g} keeps that small"
        if 2 * floor < least
        else "their spread is too near that of the others for --policy.norm_std_floor, so record what does "
        "not belong to the task at rest"
    )
    return [
        f"{len(noisy)} of {len(found.actions.behaviours)} actions are parked or tremble "
        f"({listed([each.name for each in noisy], 4)}), and normalisation makes motion of their noise: {cure}"
    ]


def _lags(found: Findings) -> list[str]:
    tracking = found.tracking
    if tracking.note is not None:
        return [
            f"{tracking.note} Executed, the robot stays behind such actions, and grippers do not press: "
            "record commands as actions where there are any"
        ]
    if found.longest_lag_s < LONG_LAG_S:
        return []
    slow = [
        f"{listed(group.joints, 4)} {_span(f'{group.shortest_s:.2g}', f'{group.longest_s:.2g}')} s"
        for group in tracking.alike
        if group.longest_s >= LONG_LAG_S
    ]
    return [
        f"the state follows the command late: {'; '.join(slow)}: check that both were written at the same "
        f"moment, and let chunks be much longer: --policy.horizon_s={_horizon(3 * found.longest_lag_s)}"
    ]


def _ways(found: Findings) -> list[str]:
    ways = found.ways
    if ways.number is None or ways.number < 2:
        return []
    sizes = " + ".join(str(len(group)) for group in ways.groups)
    return [
        f"the task is done in {ways.number} ways ({sizes} episodes) that begin alike, and their mean is none "
        "of them: take a policy that can choose (--policy.type=diffusion_chunked or vqbet_chunked), or "
        "record one way alone"
    ]


def _pace(found: Findings) -> list[str]:
    if found.pace_spread < UNEVEN_PACE:
        return []
    return [
        f"the fastest tenth of the episodes moves {found.pace_spread:.1f} times as fast as the slowest: "
        "policies imitate the mean of both, so delete the slowest, or record them again"
    ]


def _horizon(seconds: float) -> str:
    """At least that long, in halves of a second."""
    return f"{max(1.0, np.ceil(2 * seconds + 0.5) / 2):g}"


def _span(least: str, most: str) -> str:
    return least if least == most else f"{least} to {most}"


def _numbers(episodes: Sequence[int]) -> str:
    return listed([str(each) for each in episodes], 12)
