"""May a checkpoint act on a robot? What differs, how fast it is, and in which ways it can act."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from statistics import median
from typing import Any, ClassVar

import torch
from lerobot.datasets import LeRobotDataset
from lerobot.policies.utils import prepare_observation_for_inference
from lerobot.utils.feature_utils import build_dataset_frame
from rich.console import Console
from rich.markup import escape

from act_chunking_runtime.number_checks import check_positive
from lerobot_act_chunking.data.actions import require_dataset
from lerobot_act_chunking.diagnostics.core.fit import (
    Finding,
    check_fit,
    check_normalisation,
    check_pose,
    failed,
)
from lerobot_act_chunking.diagnostics.core.in_time import Way, act, play, time_chunks, ways_to_act
from lerobot_act_chunking.diagnostics.core.report import Judgement, Report
from lerobot_act_chunking.diagnostics.core.robots import make_robot, robot_features
from lerobot_act_chunking.diagnostics.core.terminal import COLOURS, print_verdict, table_of
from lerobot_act_chunking.diagnostics.core.training import read_training
from lerobot_act_chunking.errors import ConfigurationError
from lerobot_act_chunking.policies.loading import LoadedPolicy, load_policy
from lerobot_act_chunking.policies.trained_on import TrainedOn, wrong_rate


@dataclass(frozen=True)
class Settings:
    """What is asked.

    Attributes:
        checkpoint: folder or repo id.
        robot: ``type=...`` and fields of its configuration, as LeRobot's ``--robot`` takes them.
        dataset: folder of recordings; instead of a robot, or none of both.
        fps: control steps per second; None for those of the training.
        connect: whether the robot is connected, to read one observation.
        seconds: how long the policy acts on a recording.
        rename_map: the policy's names of what the robot or the dataset calls otherwise.

    Raises:
        ConfigurationError: a robot and a dataset, ``connect`` or other names without either, or a number
            below 0.
        DatasetError: there is no dataset.
    """

    checkpoint: str
    robot: tuple[str, ...] = ()
    dataset: str | None = None
    fps: float | None = None
    connect: bool = False
    seconds: float = 5.0
    rename_map: Mapping[str, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if self.robot and self.dataset:
            raise ConfigurationError("--robot and --dataset are checked one at a time: leave one of them out")
        if self.connect and not self.robot:
            raise ConfigurationError("--connect needs a robot: give --robot.type")
        if self.rename_map and not (self.robot or self.dataset):
            raise ConfigurationError(
                "--rename_map needs a robot or a dataset: give --robot.type or --dataset"
            )
        check_positive(seconds=self.seconds, **({} if self.fps is None else {"fps": self.fps}))
        if self.dataset is not None:
            require_dataset(self.dataset)


@dataclass(frozen=True, kw_only=True)
class CheckReport(Report):
    """What was compared and measured.

    Attributes:
        checkpoint: its name.
        findings: what was compared.
        fps: control steps per second; None if not known.
        chunk_s: how long each measured chunk took.
        ways: how the policy can act; none without a rate.
        ticks_s: how long each control step on the recording took.
    """

    tool: ClassVar[str] = "check"
    checkpoint: str
    findings: list[Finding]
    fps: float | None
    chunk_s: list[float]
    ways: list[Way]
    ticks_s: list[float]

    @property
    def late(self) -> int:
        """Control steps on the recording that took longer than one may."""
        return sum(each > 1 / self.fps for each in self.ticks_s) if self.fps else 0

    def content(self) -> dict[str, Any]:
        """Plain numbers, strings, lists and dictionaries."""
        return {
            "checkpoint": self.checkpoint,
            "verdict": self.verdict,
            "reasons": self.reasons,
            "fps": self.fps,
            "chunk_s": {"median": median(self.chunk_s), "longest": max(self.chunk_s)},
            "ways": [asdict(each) for each in self.ways],
            "findings": [asdict(each) for each in self.findings],
            "ticks": {
                "n": len(self.ticks_s),
                "late": self.late,
                "longest_s": max(self.ticks_s, default=None),
            },
        }


def diagnose(settings: Settings, policy: LoadedPolicy | None = None) -> CheckReport:
    """Does a checkpoint fit, and can it act in time?

    Args:
        settings: what is asked.
        policy: the checkpoint, if it is loaded.

    Raises:
        ConfigurationError: a checkpoint or a robot that cannot be made.
    """
    policy = policy or load_policy(settings.checkpoint)
    config = policy.policy.config
    known = getattr(config, "trained_on", None) or TrainedOn()
    known_fps = known.fps or read_training(settings.checkpoint, config).fps
    findings, fps = check_normalisation(policy), settings.fps or known_fps
    batches = [_middle(config, known)]
    if settings.robot:
        robot = make_robot(settings.robot)
        findings += check_fit(config, known, _renamed(robot_features(robot), settings.rename_map))
        if settings.connect and not failed(findings):
            batches = [_observe(robot, config, settings.rename_map)]
    elif settings.dataset is not None:
        data: Any = LeRobotDataset("local/checked", root=settings.dataset)
        findings += check_fit(config, known, _renamed(data.meta.features, settings.rename_map))
        fps = settings.fps or float(data.meta.fps)
        if not failed(findings):
            n = min(max(1, round(settings.seconds * fps)), len(data))
            items = [_renamed(data[step], settings.rename_map) for step in range(n)]
            batches = [_batch_of(each, config) for each in items]
    findings += _check_rate(config, fps)
    real = settings.connect or settings.dataset is not None
    if real and not failed(findings):
        findings += check_pose(known, batches[0], act(policy, batches[0]))
    chunk_s = time_chunks(policy, batches[0])
    ways = ways_to_act(config, policy.policy, max(chunk_s), fps) if fps else []
    ticks = play(policy, batches, fps) if fps and len(batches) > 1 else []
    judgement = judge(findings, ways)
    return CheckReport(
        judgement=judgement, checkpoint=settings.checkpoint, findings=findings, fps=fps, chunk_s=chunk_s,
        ways=ways, ticks_s=ticks,
    )  # fmt: skip


def _check_rate(config: Any, fps: float | None) -> list[Finding]:
    if fps is None:
        return [Finding("warn", "the rate of the training is not known, so nothing says in time: give --fps")]
    wrong = wrong_rate(config, fps)
    return [Finding("warn", wrong)] if wrong else []


def _middle(config: Any, known: TrainedOn) -> dict[str, Any]:
    """An observation to measure time with, in the middle of what is known."""
    found = {key: torch.zeros(1, *each.shape) for key, each in config.input_features.items()}
    for key in found.keys() & known.low.keys():
        found[key] = (torch.tensor([known.low[key]]) + torch.tensor([known.high[key]])) / 2
    return {**found, "task": [_task(config)]}


def _task(config: Any) -> str:
    """Something that the policy was told in its training, if it follows instructions."""
    known = getattr(config, "instructions", None)
    return known.tasks[0] if known is not None and known.tasks else ""


def _batch_of(item: Mapping[str, Any], config: Any) -> dict[str, Any]:
    batch = {key: item[key].reshape(1, *each.shape) for key, each in config.input_features.items()}
    return {**batch, "task": [item.get("task", _task(config))]}


def _renamed(there: Mapping[str, Any], rename_map: Mapping[str, str]) -> dict[str, Any]:
    """The same by the policy's names, as ``lerobot-rollout --rename_map`` gives them to it."""
    if gone := sorted(rename_map.keys() - there.keys()):
        raise ConfigurationError(
            f"--rename_map renames {', '.join(gone)}, but there are: {', '.join(sorted(there))}"
        )
    return {rename_map.get(key, key): each for key, each in there.items()}


def _observe(robot: Any, config: Any, rename_map: Mapping[str, str]) -> dict[str, Any]:
    """One observation; nothing is sent."""
    robot.connect()
    try:
        seen = robot.get_observation()
    finally:
        robot.disconnect()
    known = robot_features(robot).items()
    features = {key: each for key, each in known if rename_map.get(key, key) in config.input_features}
    frame = _renamed(build_dataset_frame(features, seen, "observation"), rename_map)
    batch = prepare_observation_for_inference(frame, torch.device("cpu"), "", robot.name)
    return {**batch, "task": [_task(config)]}


def judge(findings: list[Finding], ways: list[Way]) -> Judgement:
    """The verdict: the worst of what was found, and whether any way of acting is fast enough."""
    found = list(findings)
    going = [each.option for each in ways if each.go]
    if ways and not going:
        text = (
            "the policy is too slow for every way of acting: a GPU, fewer inference steps, a smaller policy"
        )
        found.append(Finding("fail", text))
    elif ways and not ways[0].go:
        found.append(Finding("warn", f"{ways[0].text}; {', '.join(going)} would not wait"))
    worst = next((level for level in ("fail", "warn") if any(f.level == level for f in found)), "pass")
    reasons = [each.text for each in found if each.level == worst]
    return Judgement(worst, reasons)


def print_report(report: CheckReport, console: Console) -> None:
    """Print what was compared, the ways of acting, and the verdict."""
    console.print(f"[bold]Before the arm moves[/] [dim]({escape(report.checkpoint)})[/]", soft_wrap=True)
    for each in report.findings:
        colour = COLOURS[each.level]
        console.print(f"[{colour}]{each.level}[/]  {escape(each.text)}", highlight=False, soft_wrap=True)
    times = f"a chunk takes {1000 * median(report.chunk_s):.0f} ms (longest {1000 * max(report.chunk_s):.0f})"
    console.print(times if report.fps is None else f"{times} at {report.fps:g} control steps a second")
    if report.ways:
        table = table_of("way of acting", "", "why")
        for way in report.ways:
            table.add_row(way.option, "[green]go[/]" if way.go else "[red]no go[/]", escape(way.text))
        console.print(table)
    if report.ticks_s:
        longest = 1000 * max(report.ticks_s)
        console.print(
            f"on the recording: {report.late} of {len(report.ticks_s)} control steps late, "
            f"longest {longest:.0f} ms"
        )
    print_verdict(report, console)
