"""What is executed stays within the demonstrations, is counted, and is told; every type and every way."""

import logging
from dataclasses import replace
from types import SimpleNamespace

import lerobot.rollout.inference.rtc as engine_module
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import torch
from lerobot.policies.factory import get_policy_class, make_pre_post_processors
from planted_meta import meta_of
from policy_case import STATE, A
from policy_cases import CASES, WRAPPED

from lerobot_act_chunking.data.actions import largest_changes
from lerobot_act_chunking.errors import ConfigurationError
from lerobot_act_chunking.execution.limits import ActionLimits
from lerobot_act_chunking.policies import late_chunks
from lerobot_act_chunking.policies.loading import load_policy
from lerobot_act_chunking.policies.temporal_ensemble.wrapping import load_wrapped

FIRST = {case.type: case for case in reversed([*CASES, *WRAPPED]) if case.inputs == STATE}
NAMES = [f"joint_{dim}" for dim in range(A)]
LOW, HIGH, CHANGE = -1.0, 1.0, 0.25  # in units in which the policies' are 3 wide, and begin at 2
SCALE, OFFSET = 3.0, 2.0


def limits(low=LOW, high=HIGH, change=CHANGE, scale=1.0, offset=0.0):
    values = {"low": low, "high": high, "change": change, "scale": scale, "offset": offset}
    return ActionLimits(NAMES, **{name: torch.full((A,), value) for name, value in values.items()})


def test_what_is_within_the_limits_stays_as_it_is_to_the_bit():
    generator = torch.Generator().manual_seed(0)
    held = limits(low=-100.0, high=100.0, change=100.0, scale=SCALE, offset=OFFSET)
    for _ in range(20):
        actions = torch.randn(3, A, generator=generator)
        assert torch.equal(held.normalised(actions), actions)
    assert (held.n_actions, held.summary) == (60, "")


def test_range_and_speed_are_kept_in_every_environment_and_each_begins_anew():
    generator, held = torch.Generator().manual_seed(0), limits()
    before = None
    for step in range(30):
        executed = held(3 * torch.randn(2, A, generator=generator))
        assert executed.abs().max() <= HIGH
        if before is not None:
            changes = (executed - before).abs()
            assert changes[0].max() <= CHANGE + 1e-6
            assert bool(changes[1].max() > CHANGE + 1e-6) is (step == 10)
        before = executed
        if step == 9:
            before[1] = executed[1] = 5.0  # of another rollout
            held.reset(torch.tensor([1]))


def test_what_is_held_back_is_told_once_when_it_begins_and_once_in_all(caplog):
    held = limits()
    with caplog.at_level(logging.INFO):
        held.report()
        assert not caplog.records  # nothing was executed
        for value in (0.0, 0.1, 0.9, 5.0):
            held(torch.tensor([[value, 0.0, 0.0, 0.0]]))
        held.report()
    began, told = (each.getMessage() for each in caplog.records)
    assert "joint_0 1 times too fast" in began
    assert told == "limits held back joint_0 1 times beyond the range, joint_0 2 times too fast, in 4 actions"


def test_one_wild_episode_and_the_seams_between_episodes_decide_nothing(tmp_path):
    rng = np.random.default_rng(0)
    actions = np.concatenate(
        [100 * each + np.cumsum(rng.uniform(-1, 1, (30, A)), axis=0) for each in range(40)]
    )
    actions[50, 0] += 1000.0  # one broken frame
    (tmp_path / "data").mkdir()
    rows = {"action": list(actions), "episode_index": np.repeat(np.arange(40), 30)}
    pq.write_table(pa.table(rows), tmp_path / "data" / "file.parquet")
    assert (largest_changes(tmp_path, A) <= 1).all()
    assert (largest_changes(tmp_path, A) > 0.9).all()
    assert largest_changes(tmp_path / "nowhere", A).size == 0


def test_actions_of_one_value_are_numbers_in_lerobots_files(tmp_path):
    (tmp_path / "data").mkdir()
    rows = {"action": [0.0, 0.5, 0.25, 9.0, 9.0, 8.5], "episode_index": [0, 0, 0, 1, 1, 1]}
    pq.write_table(pa.table(rows), tmp_path / "data" / "file.parquet")
    np.testing.assert_allclose(largest_changes(tmp_path, 1), [0.5])


@pytest.fixture
def checkpoint(tmp_path):
    """Save a policy of some type that was trained on demonstrations, with processors."""

    def save(kind, **settings):
        case = FIRST[kind]
        torch.manual_seed(0)
        config, meta = case.config(**settings), meta_of(tmp_path / "data")
        meta.features["action"]["names"] = NAMES
        policy = get_policy_class(config.type)(config, dataset_meta=meta)
        known = policy.config.trained_on
        assert (np.array(known.largest_change) > 0).all()
        small = {"low": {"action": [LOW] * A}, "high": {"action": [HIGH] * A}, "largest_change": [CHANGE] * A}
        policy.config.trained_on = replace(known, **small)
        assert policy.limits is None  # while it is trained
        numbers = {"mean": torch.full((A,), OFFSET), "std": torch.full((A,), SCALE)}
        numbers |= {"min": torch.full((A,), OFFSET - SCALE), "max": torch.full((A,), OFFSET + SCALE)}
        state = {"mean": torch.zeros(6), "std": torch.ones(6), "min": -torch.ones(6), "max": torch.ones(6)}
        for part in (
            policy,
            *make_pre_post_processors(config, dataset_stats={"action": numbers, "observation.state": state}),
        ):
            part.save_pretrained(tmp_path / "policy")
        return str(tmp_path / "policy")

    return save


def executed_by(loaded, steps=12):
    observations = torch.randn(steps, 2, 6, generator=torch.Generator().manual_seed(1))
    loaded.reset()
    with torch.inference_mode():
        batches = [loaded.preprocessor({"observation.state": each}) for each in observations]
        return torch.stack([loaded.postprocessor(loaded.policy.select_action(each)) for each in batches])


@pytest.mark.parametrize("kind", FIRST)
def test_every_type_executes_within_the_demonstrations(checkpoint, kind):
    path = checkpoint(kind, action_limits="demonstrations", limit_margin=0.0, max_speed=0.5)
    loaded = load_policy(path)
    executed = executed_by(loaded)
    assert executed.min() >= LOW - 1e-5
    assert executed.max() <= HIGH + 1e-5
    assert executed.diff(dim=0).abs().max() <= 0.5 * CHANGE + 1e-5
    assert loaded.policy.limits.n_actions == 24
    assert "beyond the range" in loaded.policy.limits.summary


@pytest.mark.parametrize("wrapped", [False, True])
def test_a_new_episode_is_not_held_back_by_the_one_before(checkpoint, wrapped):
    loaded = (load_wrapped if wrapped else load_policy)(checkpoint("act_chunked", max_speed=0.01))
    first, again = executed_by(loaded), executed_by(loaded)
    assert (first[0] - first[-1]).abs().max() > 0.01 * CHANGE  # what the last of the first would hold back
    torch.testing.assert_close(first, again, rtol=0, atol=0)


def test_a_wrapper_keeps_to_the_limits_of_what_it_wraps(checkpoint):
    loaded = load_wrapped(checkpoint("act_chunked", action_limits="demonstrations"))
    margin = 0.05 * (HIGH - LOW)
    executed = executed_by(loaded)
    assert executed.max() <= HIGH + margin + 1e-5
    assert executed.max() > HIGH


def test_real_time_chunking_executes_within_the_demonstrations(checkpoint, monkeypatch):
    policy = load_policy(checkpoint("act_chunked", action_limits="demonstrations")).policy
    engine_class = engine_module.RTCInferenceEngine
    original = getattr(engine_class.get_action, "__wrapped__", engine_class.get_action)
    monkeypatch.setattr(engine_class, "get_action", original)
    late_chunks.install(policy)
    engine = engine_class.__new__(engine_class)
    told = iter([torch.full((A,), 7.0), torch.zeros(A), None])
    queue = SimpleNamespace(get=lambda: next(told), original_queue=None, merge=lambda *_: None)
    vars(engine).update(_policy=policy, _action_queue=queue, _fps=30)
    assert engine.get_action(None).tolist() == pytest.approx([HIGH + 0.05 * (HIGH - LOW)] * A)
    assert torch.equal(engine.get_action(None), torch.zeros(A))
    assert engine.get_action(None) is None


@pytest.mark.parametrize(
    ("settings", "gone", "said"),
    [
        ({"action_limits": "demonstrations"}, {"low": {}}, "does not know the range of its demonstrations"),
        (
            {"max_speed": 1.0},
            {"largest_change": []},
            "max_speed=1.0: this checkpoint does not know the speed",
        ),
    ],
)
def test_a_checkpoint_that_does_not_know_its_demonstrations_says_what_to_do(checkpoint, settings, gone, said):
    path = checkpoint("act_chunked", **settings)
    config = load_policy(path).policy.config
    config.trained_on = replace(config.trained_on, **gone)
    config.save_pretrained(path)
    with pytest.raises(ConfigurationError, match=said) as error:
        load_policy(path)
    assert "lerobot-train --policy.path=<checkpoint> --steps=1" in str(error.value)


@pytest.mark.parametrize(
    ("settings", "said"),
    [
        ({"limit_margin": 0.1}, "no effect with action_limits=none: set action_limits=demonstrations"),
        ({"max_speed": 0.0}, "max_speed=0.0 must be above 0"),
        ({"action_limits": "demonstrations", "limit_margin": -1.0}, "limit_margin=-1.0 must be at least 0"),
        ({"action_limits": "data"}, "none, demonstrations"),
    ],
)
@pytest.mark.parametrize("kind", FIRST)
def test_nonsense_is_refused_at_once(kind, settings, said):
    with pytest.raises(ConfigurationError, match=said):
        FIRST[kind].config(**settings)
