"""The declared table against the originals: layouts, names, ranges, limits, cameras."""

from dataclasses import replace

import gymnasium as gym
import numpy as np
import pytest

from lerobot_act_chunking.envs.robotics.layout import Part, RoboticsTask
from lerobot_act_chunking.envs.robotics.original import make_original
from lerobot_act_chunking.envs.robotics.tasks import TASKS, get_task
from lerobot_act_chunking.errors import ConfigurationError

FETCH = [name for name in TASKS if name.startswith("Fetch")]
ADROIT = [name for name in TASKS if name.startswith("Adroit")]


@pytest.fixture(scope="module")
def originals():
    """Each original environment, after ten random steps: (environment, observation)."""
    made = {}

    def get(name):
        if name not in made:
            env = make_original(name)
            env.reset(seed=1)
            rng = np.random.default_rng(2)
            for _ in range(10):
                observation = env.step(rng.uniform(-1, 1, env.action_space.shape))[0]
            made[name] = env, observation
        return made[name]

    yield get
    for env, _ in made.values():
        env.close()


def split(name, observation):
    """Every part by its name, as `RoboticsEnv` observes it."""
    task = get_task(name)
    state, environment = task.split(observation)
    return {part: state[where] for part, where in task.state.items()} | {
        part: environment[where] for part, where in task.environment.items()
    }


@pytest.mark.parametrize("name", TASKS)
def test_the_table_says_what_the_original_says(name, originals):
    env, observation = originals(name)
    task, spec = get_task(name), gym.spec(name)
    assert (task.episode_length, task.fps) == (spec.max_episode_steps, env.metadata["render_fps"])
    low, high = env.action_space.low, env.action_space.high
    assert (set(low), set(high), low.shape) == ({-1.0}, {1.0}, (len(task.actions),))
    cameras = [env.model.camera(i).name for i in range(env.model.ncam)]
    assert task.cameras == ("view", *cameras)
    state, environment = task.split(observation)
    assert (len(state), len(environment)) == (len(task.state_names), len(task.environment_names))
    assert len(set(task.state_names)) == len(state)
    assert len(set(task.environment_names)) == len(environment)


@pytest.mark.parametrize("name", [name for name in TASKS if not name.startswith("Fetch")])
def test_actions_are_named_like_the_actuators(name, originals):
    env, _ = originals(name)
    actuators = [env.model.actuator(i).name for i in range(env.model.nu)]
    bare = [actuator.removeprefix("robot0:").removeprefix("A_") for actuator in actuators]
    assert get_task(name).actions == tuple(bare)


@pytest.mark.parametrize("name", FETCH)
def test_fetch_parts_are_where_the_simulation_has_them(name, originals):
    env, observation = originals(name)
    parts = split(name, observation)
    assert np.array_equal(parts["grip_pos"], env.data.site("robot0:grip").xpos)
    assert np.array_equal(parts["gripper_state"], env.data.qpos[13:15])
    assert np.array_equal(parts["gripper_vel"], env.data.qvel[13:15] * env.dt)
    assert np.array_equal(parts["desired_goal"], env.goal)
    if "object_pos" in parts:
        assert np.array_equal(parts["object_pos"], env.data.site("object0").xpos)
        assert np.array_equal(parts["object_rel_pos"], parts["object_pos"] - parts["grip_pos"])


@pytest.mark.parametrize("name", FETCH)
def test_the_robot_is_the_same_in_all_fetch_tasks(name):
    state = get_task(name).state
    assert {part: (where.start, where.stop) for part, where in state.items()} == {
        "grip_pos": (0, 3),
        "gripper_state": (3, 5),
        "grip_velp": (5, 8),
        "gripper_vel": (8, 10),
    }


@pytest.mark.parametrize(
    ("name", "joints"),
    [
        ("AdroitHandDoor-v1", slice(1, 28)),
        ("AdroitHandHammer-v1", slice(0, 26)),
        ("AdroitHandPen-v1", slice(0, 24)),
        ("AdroitHandRelocate-v1", slice(0, 30)),
        ("HandReach-v3", slice(0, 24)),
        ("HandManipulateEgg-v1", slice(0, 24)),
    ],
)
def test_hands_begin_with_the_robots_joints(name, joints, originals):
    env, observation = originals(name)
    state, _ = get_task(name).split(observation)
    assert np.array_equal(state[: joints.stop - joints.start], env.data.qpos[joints])


def test_adroit_parts_are_where_the_simulation_has_them(originals):
    env, observation = originals("AdroitHandDoor-v1")
    parts = split("AdroitHandDoor-v1", observation)
    assert np.array_equal(parts["palm_pos"], env.data.site("S_grasp").xpos)
    assert np.array_equal(parts["handle_pos"], env.data.site("S_handle").xpos)
    assert parts["latch"] == env.data.joint("latch").qpos
    assert parts["door_hinge"] == env.data.joint("door_hinge").qpos

    env, observation = originals("AdroitHandHammer-v1")
    parts = split("AdroitHandHammer-v1", observation)
    assert parts["nail"] == env.data.joint("nail_dir").qpos
    assert np.array_equal(parts["palm_pos"], env.data.site("S_grasp").xpos)
    assert np.array_equal(parts["hammer_pos"], env.data.body("Object").xpos)
    assert np.array_equal(parts["nail_pos"], env.data.site("S_target").xpos)

    env, observation = originals("AdroitHandPen-v1")
    parts = split("AdroitHandPen-v1", observation)
    assert np.array_equal(parts["pen_pos"], env.data.body("Object").xpos)
    assert np.allclose(parts["pen_direction"] - parts["target_direction"], parts["direction_error"])

    env, observation = originals("AdroitHandRelocate-v1")
    parts = split("AdroitHandRelocate-v1", observation)
    palm, ball = env.data.site("S_grasp").xpos, env.data.body("Object").xpos
    assert np.array_equal(parts["ball_to_palm"], palm - ball)
    assert np.array_equal(
        parts["target_to_palm"] - parts["ball_to_palm"], ball - env.data.site("target").xpos
    )


def test_the_kitchen_observes_its_joints_up_to_its_noise(originals):
    env, observation = originals("FrankaKitchen-v1")
    parts = split("FrankaKitchen-v1", observation)
    assert np.abs(parts["robot_qpos"] - env.data.qpos[:9]).max() < 0.01
    assert np.abs(parts["object_qpos"] - env.data.qpos[9:]).max() < 0.001
    assert np.abs(parts["object_qvel"] - env.data.qvel[9:]).max() < 0.001
    for element, goal in env.goal.items():
        assert np.array_equal(parts[element], goal)


@pytest.mark.parametrize("name", [name for name in TASKS if TASKS[name].goal and "Kitchen" not in name])
def test_the_achieved_goal_is_among_the_parts(name, originals):
    _, observation = originals(name)
    parts = split(name, observation)
    achieved = {"Push": "object_pos", "Slide": "object_pos", "Pick": "object_pos", "FetchReach": "grip_pos"}
    achieved |= {"HandReach": "fingertips", "Manipulate": "object_pose"}
    (where,) = [part for key, part in achieved.items() if key in name]
    assert np.array_equal(parts[where], observation["achieved_goal"])


TOY = RoboticsTask(
    "Do it.",
    (Part("arm", 2, robot=True), Part("thing", 1), Part("hand", 1, robot=True)),
    actions=("a",),
    fps=10,
    episode_length=5,
    succeeds=lambda info: info["won"],
    goal=(Part("left", 1), Part("right", 2)),
)


def test_a_goal_of_several_members_is_flattened_in_the_order_of_the_table():
    goal = {"right": np.array([7.0, 8.0]), "left": np.array([6.0])}
    state, environment = TOY.split({"observation": np.array([1.0, 2.0, 3.0, 4.0]), "desired_goal": goal})
    assert (state.tolist(), environment.tolist()) == ([1, 2, 4], [3, 6, 7, 8])
    assert TOY.state_names == ("arm_0", "arm_1", "hand")
    assert TOY.environment_names == ("thing", "left", "right_0", "right_1")
    assert (TOY.state["hand"], TOY.environment["right"]) == (slice(2, 3), slice(2, 4))


def test_velocities_are_left_out_of_whatever_has_them():
    parts = (Part("arm", 1, robot=True), Part("arm_vel", 2, robot=True, velocity=True))
    toy = replace(TOY, parts=(*parts, Part("thing_vel", 1, velocity=True), Part("thing", 1)), goal=())
    still = toy.without_velocities()
    assert [part.tolist() for part in toy.split(np.arange(5))] == [[0, 1, 2], [3, 4]]
    assert [part.tolist() for part in still.split(np.arange(5))] == [[0], [4]]
    assert (still.state_names, still.environment_names) == (("arm",), ("thing",))
    assert (still.state, still.environment) == ({"arm": slice(0, 1)}, {"thing": slice(0, 1)})


@pytest.mark.parametrize("name", TASKS)
def test_the_table_knows_the_velocities(name):
    task = get_task(name)
    named = {part.name for part in task.parts if "vel" in part.name}
    assert {part.name for part in task.parts if part.velocity} == named


def test_another_layout_is_refused():
    with pytest.raises(
        ConfigurationError,
        match=r"observes \(5,\), the declared layout is \(4,\): pip install 'gymnasium-robotics>=1.4,<2'",
    ):
        TOY.split({"observation": np.zeros(5), "desired_goal": {}})


def test_an_unknown_task_is_told_the_others():
    with pytest.raises(
        ConfigurationError, match=r"unknown gymnasium_robotics task 'FetchPush-v1'; .*FrankaKitchen-v1"
    ):
        get_task("FetchPush-v1")
