from typing import get_args

import pytest

from lerobot_act_chunking.envs.aloha.options import AlohaSimOptions, TaskName
from lerobot_act_chunking.envs.aloha.tasks import TASKS
from lerobot_act_chunking.errors import ConfigurationError

CAMERA_LIST = "top, angle, front_close, left_pillar, right_pillar, left_wrist, right_wrist"


def test_task_names_match_the_tasks():
    assert get_args(TaskName) == TASKS


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"task": "pour"}, "unknown task 'pour'; choose one of: transfer_cube, insertion"),
        ({"obs_type": "image"}, "unknown obs_type 'image'; choose one of: state, pixels, pixels_state"),
        ({"render_quality": "best"}, "unknown render_quality 'best'; choose one of: full, fast"),
        ({"success": "grab"}, "unknown success rule 'grab'; choose one of: touch, hold"),
        ({"cameras": ["side"]}, f"unknown camera 'side'; choose one of: {CAMERA_LIST}"),
        ({"cameras": "top"}, r"cameras is a list of names: write \['top'\]"),
        ({"cameras": ["top", "top"]}, "names one twice"),
        ({"cameras": [], "obs_type": "pixels"}, f"obs_type pixels needs cameras, of: {CAMERA_LIST}"),
        ({"observation_height": 0}, "observation_height is a whole number of pixels, 1 to 4096, got 0"),
        ({"observation_width": 4097}, "observation_width is a whole number of pixels"),
        ({"visualization_height": -3}, "visualization_height is a whole number of pixels"),
        (
            {"visualization_width": 84.0},
            "visualization_width is a whole number .* got 84.0",
        ),
        ({"observation_width": True}, "observation_width is a whole number of pixels"),
        ({"agent_vel": True, "obs_type": "pixels"}, "agent_vel needs obs_type state or pixels_state"),
    ],
)
def test_what_cannot_work_is_refused_with_the_alternatives(options, message):
    with pytest.raises(ConfigurationError, match=message):
        AlohaSimOptions(**options)


def test_state_needs_no_camera():
    assert AlohaSimOptions(cameras=[]).obs_type == "state"
