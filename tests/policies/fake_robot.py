"""A robot without hardware, as LeRobot's rollout engines see one."""

import torch

JOINTS = ("joint_0.pos", "joint_1.pos")


class FakeRobot:
    """Goes where it is told, at once; every action takes a step of time."""

    robot_type = name = "fake"
    action_features = observation_features = dict.fromkeys(JOINTS, float)
    is_connected = True

    def __init__(self, position: float):
        self.positions = dict.fromkeys(JOINTS, position)
        self.time = 0.0
        self.actions = []

    def get_observation(self):
        return dict(self.positions)

    def send_action(self, action):
        self.positions = action
        self.actions.append(torch.tensor(list(action.values())))
