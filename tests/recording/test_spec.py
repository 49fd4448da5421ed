from pathlib import Path

import pytest

from lerobot_act_chunking.envs.demonstration import ExpertOptions
from lerobot_act_chunking.errors import ConfigurationError
from lerobot_act_chunking.recording import RecordSpec


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"task": "juggle"}, "unknown task 'juggle'; choose one of: transfer_cube, insertion"),
        ({"obs": "smell"}, "unknown obs_type 'smell'; choose one of: state, pixels, pixels_state"),
        (
            {"obs": "pixels", "cameras": ("top", "back")},
            "unknown camera 'back'; choose one of: top, angle, front_close",
        ),
        ({"obs": "pixels", "cameras": ("top", "top")}, "names one twice"),
        ({"cameras": ("top", "angle")}, "obs state records no cameras, got top, angle; use pixels or"),
        ({"obs": "pixels", "image_height": 0}, "observation_height is a whole number of pixels, 1 to 4096"),
        ({"obs": "pixels", "image_width": 99999}, "observation_width is a whole number of pixels"),
        ({"obs": "pixels", "image_width": 31}, "image_width is 31; H.264 videos need even sizes"),
        ({"obs": "pixels", "velocity": True}, "agent_vel needs obs_type state or pixels_state"),
        ({"render_quality": "ultra"}, "unknown render_quality 'ultra'; choose one of: full, fast"),
        ({"success": "luck"}, "unknown success rule 'luck'; choose one of: touch, hold"),
        ({"env": "so_arm_sim", "velocity": True}, "so_arm_sim observes no velocities; leave velocity out"),
        ({"env": "lab"}, "unknown env 'lab'; choose one of: aloha_sim, gymnasium_robotics, so_arm_sim"),
        ({"expert": ExpertOptions(speed=2.0)}, "expert option speed=2.0 is outside 0.7 .. 1.5 times the"),
        ({"episodes": 0}, "episodes=0 must be at least 1"),
        ({"workers": 0}, "workers=0 must be at least 1"),
        ({"seed": -1}, "seed=-1 must be at least 0"),
        *(
            ({"repo_id": bad}, f"repo id {bad!r} is not of the form user/name")
            for bad in ("cube", "a/b/c", "me/", "/cube", "me/cu be", "../cube", "me/cubé", "")
        ),
    ],
)
def test_what_cannot_work_is_refused_at_once(options, message):
    with pytest.raises(ConfigurationError) as caught:
        RecordSpec(**{"repo_id": "me/cube", **options})
    assert message in str(caught.value)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (
            {"task": "FetchPull-v4"},
            "unknown gymnasium_robotics task 'FetchPull-v4'; choose one of: Fetch",
        ),
        ({"task": "transfer_cube"}, "unknown gymnasium_robotics task 'transfer_cube'"),
        (
            {"task": "FrankaKitchen-v1"},
            "FrankaKitchen-v1 has no scripted expert; choose one of: Fetch",
        ),
        ({"success": "hold"}, "unknown success rule 'hold'; choose one of: any, final"),
        (
            {"obs": "pixels", "cameras": ("top",)},
            "unknown camera 'top'; choose one of: view, head",
        ),
        (
            {"expert": ExpertOptions(action_noise=0.2)},
            "action_noise=0.2 is outside 0.0 .. 0.15 of",
        ),
        ({"expert": ExpertOptions(dwell=1.0)}, "dwell=1.0 is outside 0.0 .. 0.4 s"),
    ],
)
def test_what_cannot_work_in_gymnasium_robotics_is_refused_at_once(options, message):
    with pytest.raises(ConfigurationError) as caught:
        RecordSpec(**{"repo_id": "me/push", "env": "gymnasium_robotics", "task": "FetchPush-v4", **options})
    assert message in str(caught.value)


@pytest.mark.parametrize(
    ("env", "task", "success", "camera"),
    [
        ("aloha_sim", "transfer_cube", "hold", "top"),
        ("gymnasium_robotics", "FetchReach-v4", "final", "view"),
        ("so_arm_sim", "pick_place", "released", "front,wrist"),
        ("three_gates", "three_gates", "outside", "top"),
    ],
)
def test_every_world_has_its_own_defaults(env, task, success, camera):
    environment = RecordSpec("me/data", env=env, obs="pixels").source().environment
    assert (environment.task, environment.success, environment.cameras) == (task, success, camera.split(","))


def test_the_environment_shows_what_is_recorded():
    spec = RecordSpec(
        "me/cube",
        Path("there"),
        task="insertion",
        obs="pixels_state",
        velocity=True,
        cameras=("angle", "left_wrist"),
        image_height=48,
        image_width=64,
        render_quality="fast",
        success="touch",
        expert=ExpertOptions(speed=1.1),
    )
    environment = spec.source().environment
    assert (environment.task, environment.obs_type, environment.success) == (
        "insertion",
        "pixels_state",
        "touch",
    )
    assert environment.cameras == ["angle", "left_wrist"]
    assert (environment.observation_height, environment.observation_width) == (48, 64)
    assert environment.agent_vel
    assert environment.render_quality == "fast"
