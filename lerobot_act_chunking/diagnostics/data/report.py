"""Everything the diagnosis found, as one object: the command prints it, JSON holds it, plots draw it."""

from dataclasses import asdict, dataclass
from typing import Any, ClassVar

from lerobot_act_chunking.diagnostics.core.recording import Recording
from lerobot_act_chunking.diagnostics.core.report import Report
from lerobot_act_chunking.diagnostics.core.tracking import Tracking
from lerobot_act_chunking.diagnostics.data.clocks import Clock
from lerobot_act_chunking.diagnostics.data.findings import Findings, Motion

NOBODY = (
    "Nothing says who demonstrated: validation cannot be held out by person (name the column with "
    "--operator-column)."
)
CHANGES = (
    "Actions are changes of the state, such as displacements or velocities: policies of this package then "
    "follow the newest chunk alone (execution=receding), unless another execution is given."
)
COUNTED = (
    "{columns} is the number of the frame divided by fps: at which rate frames were really taken is not in "
    "the dataset."
)
UNLIKE = "{odd} demonstrations are like no others: {episodes}."
BY_START = "Demonstrations fall into {number} groups, which the first action tells apart: no choice of ways."


@dataclass(frozen=True, kw_only=True)
class DataReport(Report):
    """The answer to: what is this dataset like?

    Attributes:
        recording: its sound episodes.
        findings: what was measured of them.
    """

    tool: ClassVar[str] = "data"
    recording: Recording
    findings: Findings

    @property
    def notes(self) -> list[str]:
        """What to know about the figures, in sentences."""
        found = self.findings
        notes = [*found.actions.floor.notes, *filter(None, [found.pair_note])]
        if found.changes:
            notes.append(CHANGES)
        clocks = found.clocks
        if clocks and all(each.counted for each in clocks):
            notes.append(COUNTED.format(columns=" and ".join(repr(each.column) for each in clocks)))
        if found.ways.by_start:
            notes.append(BY_START.format(number=len(found.ways.groups)))
        if found.ways.odd:
            odd = ", ".join(map(str, found.ways.odd))
            notes.append(UNLIKE.format(odd=len(found.ways.odd), episodes=odd))
        return notes if found.operators else [*notes, NOBODY]

    def content(self) -> dict[str, Any]:
        """Plain numbers, strings, lists and dictionaries; None for what was not or cannot be measured."""
        recording, found = self.recording, self.findings
        return {
            "dataset": recording.folder,
            "n_episodes": len(recording.episodes),
            "n_frames": recording.frames,
            "fps": recording.fps,
            "verdict": self.verdict,
            "reasons": self.reasons,
            "broken_episodes": {str(each): columns for each, columns in found.broken.items()},
            "clocks": [_clock_json(each, recording.fps) for each in found.clocks],
            "action": _motion_json(found.actions),
            "state": None if found.states is None else _motion_json(found.states),
            "pace_spread": found.pace_spread,
            "episodes": _episodes_json(recording, found),
            "actions_are_changes": found.changes,
            "lags": _lags_json(found.tracking),
            "ways": asdict(found.ways),
            "cameras": [asdict(each) for each in found.cameras],
            "operators": found.operators,
            "split": found.split and asdict(found.split),
            "notes": self.notes,
        }


def _clock_json(clock: Clock, fps: float) -> dict[str, Any]:
    return {**asdict(clock), "off": clock.off(fps)}


def _motion_json(motion: Motion) -> dict[str, Any]:
    return {
        "idle": asdict(motion.rests),
        "repeats": asdict(motion.repeats),
        "jump_frames": motion.jump_frames,
        "dimensions": [
            {**floor, **asdict(behaviour)}
            for floor, behaviour in zip(motion.floor.to_json(), motion.behaviours, strict=True)
        ],
    }


def _episodes_json(recording: Recording, found: Findings) -> list[dict[str, Any]]:
    """Where motion begins and ends: what to trim by."""
    return [
        {
            "episode": each.index,
            "frames": len(each),
            "first_step_in_motion": rest.start,
            "last_step_in_motion": len(each) - 2 - rest.end,
            "pauses": [{"first_step": first, "steps": steps} for first, steps in rest.pauses],
            "pace": rest.pace,
            "operator": recording.operators.get(each.index),
        }
        for each, rest in zip(recording.episodes, found.actions.stillness, strict=True)
    ]


def _lags_json(tracking: Tracking) -> dict[str, Any]:
    return {
        "dimensions": {name: lag and asdict(lag) for name, lag in tracking.joints.items()},
        "groups": [asdict(each) for each in tracking.alike],
        "undefined": tracking.undefined,
        "note": tracking.note,
    }
