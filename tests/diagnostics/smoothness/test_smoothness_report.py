"""From episodes to one report: units, groups, what is undefined, cost."""

import json
import time

import numpy as np
import pytest
from tiers import full_tier

from lerobot_act_chunking.diagnostics.core.rollouts import Inference, Rollout
from lerobot_act_chunking.diagnostics.smoothness.measuring import NO_DIMENSION, measure
from lerobot_act_chunking.diagnostics.smoothness.plots import plot_report
from lerobot_act_chunking.diagnostics.smoothness.report import SmoothnessComparison
from lerobot_act_chunking.diagnostics.smoothness.settings import EvaluationSpec, Settings
from lerobot_act_chunking.diagnostics.smoothness.terminal import chunk_table, motion_table
from lerobot_act_chunking.errors import DatasetError, FeatureError

DT, CHUNK = 0.02, 30
NAMES = ("left_waist", "left_gripper", "right_waist", "right_elbow", "right_gripper")
A = len(NAMES)
STD = np.array([1.0, 0.4, 0.5, 2.0, 0.4])


def motion(steps: int, shift: float = 0.0) -> np.ndarray:
    """Smooth, different in every joint."""
    t = DT * np.arange(steps)[:, None] - shift
    return STD * np.sin(2 * np.pi * np.array([0.5, 0.6, 0.7, 0.8, 0.9]) * t)


def episodes(
    every: int | None = 10, jump: float = 0.0, count: int = 3, success: bool = True
) -> list[Rollout]:
    """Smooth motions with a jump of all joints at each new chunk, carried out 60 ms later."""
    rollouts = []
    for seed in range(count):
        steps = 150 + 7 * seed
        t = np.arange(steps)
        offset = jump * STD * ((t // every) % 2)[:, None] if every else 0.0
        inferences = tuple(
            Inference(int(step), motion(step + CHUNK)[step:])
            for step in (range(0, steps, every) if every else ())
        )
        rollouts.append(
            Rollout(
                seed, DT, motion(steps) + offset, motion(steps, 0.06), np.zeros(steps), success, inferences
            )
        )
    return rollouts


def report_of(rollouts, **options):
    return measure(rollouts, action_std=STD, joint_names=NAMES, **options)


def test_a_report_holds_the_numbers_of_its_episodes():
    report = report_of(episodes(), name="here")
    assert (report.name, report.episodes, report.steps, report.successes) == ("here", 3, 471, 3)
    assert report.network_calls_per_episode == pytest.approx((15 + 16 + 17) / 3)
    assert report.boundaries_per_episode == pytest.approx((14 + 15 + 16) / 3)
    assert report.tracking_lag_s == pytest.approx(
        dict.fromkeys(("arms", "grippers", *NAMES), 0.06), abs=0.005
    )
    assert set(report.commanded.joints) == set(NAMES)
    assert report.disagreement.ages_s == pytest.approx([0.2, 0.4])
    assert report.disagreement.arms == pytest.approx([0.0, 0.0])
    assert report.undefined == {}


def test_jumps_at_boundaries_show_in_every_measure_of_the_command_only():
    smooth, rough = report_of(episodes()), report_of(episodes(jump=0.3))
    for group in ("arms", "grippers"):
        before, after = getattr(smooth.commanded, group), getattr(rough.commanded, group)
        assert before.boundary_ratio == pytest.approx(1.0, abs=0.15)
        assert after.boundary_ratio > 3
        assert after.boundary_acceleration_ratio > 10
        assert after.rms_jerk > 10 * before.rms_jerk
        assert after.log_dimensionless_jerk < before.log_dimensionless_jerk - 3
        assert after.sparc < before.sparc - 0.5
        assert after.energy_above_5_hz > 100 * before.energy_above_5_hz
        assert rough.boundary_to_plan_ratio[group] > 3
        assert smooth.boundary_to_plan_ratio[group] == pytest.approx(1.0, abs=0.15)
    assert rough.achieved == smooth.achieved


def test_a_jump_of_the_grippers_leaves_the_arms_alone():
    rollouts = episodes(jump=0.3)
    for rollout in rollouts:
        rollout.commands[:, [0, 2, 3]] = motion(len(rollout.commands))[:, [0, 2, 3]]
    report = report_of(rollouts)
    assert report.commanded.arms == report_of(episodes()).commanded.arms
    assert report.commanded.grippers == report_of(episodes(jump=0.3)).commanded.grippers
    assert report.commanded.joints["left_gripper"].boundary_ratio > 3
    assert report.commanded.joints["left_waist"].boundary_ratio < 1.5


def test_achieved_motion_answers_one_step_after_the_command():
    rollouts = episodes(jump=0.0)
    for rollout in rollouts:
        jumps = ((np.arange(len(rollout.positions)) - 1) // 10 % 2)[:, None] * 0.3 * STD
        rollout.positions[:] = motion(len(rollout.positions)) + jumps
    report = report_of(rollouts)
    assert report.achieved.arms.boundary_ratio > 3
    assert report.commanded.arms.boundary_ratio < 1.5


def test_jerk_of_a_joint_is_in_its_own_unit_and_that_of_a_group_in_stds():
    rollouts = episodes(every=None)
    report = report_of(rollouts)
    third = np.concatenate([np.diff(rollout.commands, 3, axis=0) for rollout in rollouts]) / DT**3
    for dim, name in enumerate(NAMES):
        assert report.commanded.joints[name].rms_jerk == pytest.approx(np.sqrt(np.mean(third[:, dim] ** 2)))
    arms = third[:, [0, 2, 3]] / STD[[0, 2, 3]]
    assert report.commanded.arms.rms_jerk == pytest.approx(np.sqrt(np.mean(arms**2)))


def test_a_joint_that_demonstrations_never_move_does_not_drown_the_others():
    std = STD.copy()
    std[0] = 1e-9
    rollouts = episodes(every=None)
    for rollout in rollouts:
        rollout.commands[:, 0] = 1e-4 * np.random.default_rng(1).normal(size=len(rollout.commands))
    report = measure(rollouts, action_std=std, joint_names=NAMES)
    assert report.commanded.arms.energy_above_5_hz < 0.01
    assert report.commanded.joints["left_waist"].energy_above_5_hz > 0.5


def test_latency_shifts_the_boundaries():
    report = report_of(episodes(jump=0.3), latency_steps=4)
    assert report.commanded.arms.boundary_ratio < 1.5
    assert report.boundaries_per_episode == pytest.approx((14 + 15 + 15) / 3, abs=0.4)


def test_every_none_has_its_reason():
    report = report_of(episodes(every=1), knows_success=False)
    assert report.successes is None
    assert report.commanded.arms.boundary_ratio is None
    assert "almost every step" in report.undefined["commanded.arms.boundary_ratio"]
    assert report.boundary_to_plan_ratio["arms"] == pytest.approx(1.0, abs=0.05)
    assert report.network_calls_per_episode == pytest.approx(report.steps / 3)

    bare = report_of(episodes(every=None))
    assert bare.network_calls_per_episode is None
    assert bare.disagreement is None
    assert {"disagreement", "commanded.arms.boundary_ratio", "boundary_to_plan_ratio.arms"} <= set(
        bare.undefined
    )

    still = episodes(every=None)
    for rollout in still:
        rollout.commands[:, 1] = 0.5
    report = report_of(still)
    assert report.commanded.joints["left_gripper"].sparc is None
    assert (
        report.undefined["commanded.joints.left_gripper.sparc"] == "undefined in every episode: nothing moves"
    )
    assert report.tracking_lag_s["left_gripper"] is None


def test_without_positions_only_the_commands_are_measured():
    rollouts = [
        Rollout(r.seed, r.dt, r.commands, np.empty((len(r.commands), 0)), r.rewards, False)
        for r in episodes()
    ]
    report = report_of(rollouts)
    assert report.achieved is None
    assert set(report.tracking_lag_s.values()) == {None}
    assert report.undefined["achieved"] == "the source holds no joint positions beside the commands"
    json.loads(json.dumps(compared([report]).to_json(), allow_nan=False))


def test_joints_without_grippers_form_one_group():
    report = measure(episodes(), action_std=STD, joint_names=[f"joint_{i}" for i in range(A)])
    assert report.commanded.grippers.sparc is None
    assert report.undefined["commanded.grippers"] == NO_DIMENSION["grippers"]
    assert report.boundary_to_plan_ratio.keys() == {"arms"}


def compared(reports):
    asked = Settings(("a", "b"), EvaluationSpec(seed=1), replan_interval=5)
    return SmoothnessComparison(requested=asked, sources=reports)


def test_json_is_strict_and_complete():
    reports = [report_of(episodes(), name="a"), report_of(episodes(every=1), name="b")]
    document = json.loads(json.dumps(compared(reports).to_json()), parse_constant=pytest.fail)
    assert document["settings"]["seed"] == 1
    assert document["settings"]["replan_interval"] == 5
    assert [source["name"] for source in document["sources"]] == ["a", "b"]
    first, second = document["sources"]
    assert first["commanded"]["joints"]["left_waist"]["sparc"] < 0
    assert second["commanded"]["arms"]["boundary_ratio"] is None
    assert len(first["curves"]["boundary_profile"]) == 21


def test_tables_have_one_row_per_source():
    reports = [report_of(episodes(), name="a"), report_of(episodes(every=None), name="b")]
    for table in (motion_table(reports), chunk_table(reports)):
        assert table.row_count == 2
        assert list(table.columns[0].cells) == ["a", "b"]
    assert list(chunk_table(reports).columns[2].cells) == ["16.0", "-"]
    assert list(chunk_table(reports).columns[1].cells) == ["100.0", "100.0"]
    assert list(motion_table(reports).columns[5].cells) == ["60", "60"]


def test_the_picture_differs_with_its_sources(tmp_path):
    from matplotlib.image import imread

    smooth, rough, bare = (
        report_of(rollouts, name="a") for rollouts in (episodes(), episodes(jump=0.3), episodes(every=None))
    )
    pictures = [
        imread(plot_report(compared(reports), tmp_path / "deep" / "picture.png"))
        for reports in ([smooth], [rough], [bare], [smooth, rough, bare])
    ]
    assert all((pictures[0] != other).mean() > 0.001 for other in pictures[1:3])
    assert pictures[3].shape[1] == pictures[0].shape[1]


@pytest.mark.parametrize(
    ("change", "error", "message"),
    [
        (lambda rollouts: rollouts[:1], DatasetError, "at least 2 episodes, got 1"),
        (lambda rollouts: [*rollouts, cut(rollouts[0], 3)], DatasetError, "episode 0 has 3 steps; a third"),
        (lambda rollouts: [*rollouts, spoil(rollouts[1])], DatasetError, "episode 1 holds .* not finite"),
    ],
)
def test_episodes_that_cannot_be_measured_are_refused(change, error, message):
    with pytest.raises(error, match=message):
        report_of(change(episodes()))


def cut(rollout: Rollout, steps: int) -> Rollout:
    return Rollout(
        rollout.seed, DT, rollout.commands[:steps], rollout.positions[:steps], np.zeros(steps), False
    )


def spoil(rollout: Rollout) -> Rollout:
    commands = rollout.commands.copy()
    commands[5, 1] = np.nan
    return Rollout(rollout.seed, DT, commands, rollout.positions, rollout.rewards, False)


def test_widths_must_agree():
    with pytest.raises(FeatureError, match=r"14 joint names, but commands are \(150, 5\)"):
        measure(episodes(), action_std=STD)
    with pytest.raises(FeatureError, match=r"action_std \(4,\)"):
        measure(episodes(), action_std=STD[:4], joint_names=NAMES)


@pytest.mark.slow
@full_tier
def test_two_hundred_episodes_that_replan_at_every_step_take_seconds():
    generator = np.random.default_rng(0)
    rollouts = []
    for seed in range(200):
        path = np.cumsum(generator.normal(size=(300, 14)), axis=0).astype(np.float32)
        inferences = tuple(Inference(step, path[step : step + 100]) for step in range(200))
        rollouts.append(Rollout(seed, DT, path[:200], path[:200], np.zeros(200), True, inferences))
    start = time.process_time()
    measure(rollouts, action_std=np.ones(14))
    assert time.process_time() - start < 30  # 4 s on a free core
