"""Rewards as functions of contacts, against gym-aloha's own code on the same contacts."""

from types import SimpleNamespace

import pytest
import stock  # noqa: F401  (imports gym-aloha quietly)
from hypothesis import given
from hypothesis import strategies as st

from lerobot_act_chunking.envs.aloha import rewards
from lerobot_act_chunking.envs.aloha.rewards import CUBE, LEFT_FINGER, PEG, PIN, RIGHT_FINGER, TABLE

RIGHT, LEFT, ON_TABLE = (CUBE, RIGHT_FINGER), (CUBE, LEFT_FINGER), (CUBE, TABLE)
GRASPED = {(PEG, RIGHT_FINGER), ("socket-3", LEFT_FINGER)}
NAMES = (TABLE, CUBE, PEG, PIN, "socket-1", "socket-2", "socket-3", "socket-4", LEFT_FINGER, RIGHT_FINGER, "")


@pytest.mark.parametrize(
    ("contacts", "reward"),
    [
        (set(), 0),
        ({ON_TABLE}, 0),
        ({ON_TABLE, RIGHT}, 1),
        ({RIGHT}, 2),
        ({ON_TABLE, LEFT}, 3),
        ({RIGHT, LEFT, ON_TABLE}, 3),
        ({RIGHT, LEFT}, 4),
        ({LEFT}, 4),
    ],
)
def test_transfer_cube(contacts, reward):
    assert rewards.transfer_cube(frozenset(contacts)) == reward


@pytest.mark.parametrize(
    ("contacts", "reward"),
    [
        (set(), 0),
        ({(PEG, RIGHT_FINGER)}, 0),
        (GRASPED | {(PEG, TABLE)}, 1),
        (GRASPED | {("socket-4", TABLE)}, 1),
        (GRASPED, 2),
        (GRASPED | {(PEG, "socket-2")}, 3),
        ({(PEG, "socket-1")}, 3),
        ({(PEG, "socket-1"), ("socket-2", TABLE)}, 0),
        ({(PEG, PIN), (PEG, TABLE)}, 4),
    ],
)
def test_insertion(contacts, reward):
    assert rewards.insertion(frozenset(contacts)) == reward


def stock_reward(task_class, contacts):
    """gym-aloha's reward for made-up contacts."""
    pairs = [SimpleNamespace(geom1=NAMES.index(a), geom2=NAMES.index(b)) for a, b in contacts]
    data = SimpleNamespace(ncon=len(pairs), contact=pairs)
    model = SimpleNamespace(id2name=lambda index, kind: NAMES[index])
    return task_class().get_reward(SimpleNamespace(data=data, model=model))


@given(st.frozensets(st.tuples(st.sampled_from(NAMES), st.sampled_from(NAMES)), max_size=20))
def test_agrees_with_gym_aloha_on_any_contacts(contacts):
    from gym_aloha.tasks.sim import InsertionTask, TransferCubeTask

    assert rewards.transfer_cube(contacts) == stock_reward(TransferCubeTask, contacts)
    assert rewards.insertion(contacts) == stock_reward(InsertionTask, contacts)
