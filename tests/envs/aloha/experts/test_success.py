"""Experts in simulation: they succeed, and keep succeeding when somewhat wrong."""

import numpy as np
import pytest
from tiers import draws

from lerobot_act_chunking.envs.aloha.experts import ExpertOptions, plan
from lerobot_act_chunking.envs.aloha.success import make_success_rule
from lerobot_act_chunking.envs.aloha.world import CONTROL_PERIOD, TASKS, AlohaWorld, sample_object_pose
from lerobot_act_chunking.envs.demonstration import correlated_noise
from lerobot_act_chunking.errors import ConfigurationError

GRIPPERS = [6, 13]


def exactly(plan_, rng):
    return plan_.commands


OF_OWN = [task for task in TASKS if task != "language_transfer"]  # whose script is that of transfer_cube


def shaken(plan_, rng):
    commands = plan_.commands.copy()
    noise = correlated_noise(commands.shape, 0.003, rng, period=CONTROL_PERIOD)
    noise[:, GRIPPERS] = 0
    return commands + noise


def late_grippers(plan_, rng):
    commands = plan_.commands.copy()
    commands[6:, GRIPPERS] = plan_.commands[:-6, GRIPPERS]
    return commands


def successes(task, seeds, execute=exactly, offset=0.0, **options):
    """Of ``seeds`` episodes, how many hold; ``offset`` [m] misplaces each object in the expert's eyes."""
    world, rule, count = AlohaWorld(task), make_success_rule("hold", task), 0
    for seed in range(seeds):
        rng = np.random.default_rng(50_000 + seed)
        pose = sample_object_pose(task, rng)
        believed = pose.copy()
        for position in believed.reshape(-1, 7)[:, :2]:
            angle = rng.uniform(0, 2 * np.pi)
            position += offset * np.array([np.cos(angle), np.sin(angle)])
        world.reset(pose)
        rule.reset()
        for command in execute(plan(task, believed, ExpertOptions(**options), rng), rng):
            world.step(command)
            rule.update(world.contacts())
        count += rule.succeeded
    return count


@pytest.mark.parametrize("task", OF_OWN)
def test_the_expert_holds_at_the_end_of_its_plan(task):
    assert successes(task, seeds=8) == 8


@pytest.mark.parametrize("task", OF_OWN)
@pytest.mark.parametrize(
    "disturbance",
    [{"offset": 0.01}, {"execute": late_grippers}, {"execute": shaken}],
    ids=["1 cm off", "grippers 0.12 s late", "arms off by 3 mrad"],
)
def test_a_somewhat_wrong_expert_still_succeeds(task, disturbance):
    assert successes(task, seeds=4, **disturbance) == 4


@pytest.mark.parametrize("task", OF_OWN)
@pytest.mark.parametrize(
    "options",
    [{"speed": 0.7}, {"speed": 1.5}, {"dwell": 0.5}, {"waypoint_noise": 0.01}, {"action_noise": 0.003}],
    ids=lambda options: "-".join(options),
)
def test_every_option_still_succeeds(task, options):
    assert successes(task, seeds=2, **options) == 2


@pytest.mark.parametrize(
    ("task", "options", "at_least"),
    [
        ("transfer_cube", {}, 4),
        ("insertion", {}, 3),
        ("transfer_cube", {"missed_grasps": 1, "speed": 1.15}, 3),
        ("transfer_cube", {"one_arm_first": 1, "speed": 1.4}, 4),
    ],
    ids=str,
)
def test_another_way_of_doing_it_succeeds(task, options, at_least):
    assert successes(task, seeds=4, stepwise=1, **options) >= at_least


@pytest.mark.slow
@pytest.mark.parametrize("task", OF_OWN)
def test_unseen_seeds(task):
    n_seeds = draws(gate=12, full=100)
    assert successes(task, seeds=n_seeds) >= n_seeds - 1


def test_unknown_tasks_are_refused():
    with pytest.raises(
        ConfigurationError, match="unknown task 'pour'; choose one of: transfer_cube, insertion"
    ):
        plan("pour", np.zeros(7), ExpertOptions(), np.random.default_rng(0))
