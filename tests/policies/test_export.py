"""Exported policies act as those in PyTorch do, from the same random numbers."""

import errno
import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import tiers
import torch
from lerobot.policies.factory import make_pre_post_processors
from policy_cases import MODULES, STATE, A

from act_chunking_runtime.errors import ConfigurationError, FeatureError
from act_chunking_runtime.files import DESCRIPTION, GRAPH
from act_chunking_runtime.policy import load
from lerobot_act_chunking.policies.exporting import export as exporting
from lerobot_act_chunking.policies.exporting.acting import acting_of
from lerobot_act_chunking.policies.exporting.elementary import next_below, normal_quantile
from lerobot_act_chunking.policies.exporting.export import export
from lerobot_act_chunking.policies.exporting.network import ExportedNetwork
from lerobot_act_chunking.policies.exporting.onnx_graph import check_graph
from lerobot_act_chunking.policies.limits import limits_of
from lerobot_act_chunking.policies.loading import LoadedPolicy
from lerobot_act_chunking.policies.trained_on import TrainedOn

FOREIGN = {"torch", "lerobot", "lerobot_act_chunking", "gymnasium", "jaxtyping"}
CLOSE = 1e-5  # of the largest action, or of 1, the scale of normalised ones
PASSED = {"latent_draws": "noise", "action_draws": "draws", "noise": "noise", "code_draws": "noise"}
CASES = {module: module.EXPORTED for module in MODULES.values() if hasattr(module, "EXPORTED")}
FAST = [cases[0] for cases in CASES.values()]
ALONE = next(case for case in FAST if case.inputs == STATE)
"""From joint positions alone, and drawing something."""


def loaded(case):
    """A policy with the processors of a dataset, whose limits are narrow enough to be met."""
    policy = case.policy().eval()
    config = policy.config
    shapes = {key: each.shape for key, each in {**config.input_features, **config.output_features}.items()}
    stats = {}
    for key, shape in shapes.items():
        size = shape if len(shape) == 1 else (shape[0], 1, 1)
        offset = torch.arange(size[0], dtype=torch.float32).reshape(size)
        stats[key] = {"mean": offset, "std": 1 + offset, "min": offset - 2, "max": offset + 2}
    config.trained_on = TrainedOn(
        fps=50.0,
        names={"action": [f"joint_{dim}" for dim in range(A)]},
        low={"action": [-0.2] * A},
        high={"action": [2.0] * A},
        largest_change=[0.1] * A,
    )
    if config.limits_actions:
        numbers = torch.arange(A, dtype=torch.float32)
        policy.limits = limits_of(config, 1 + numbers, numbers)
    return LoadedPolicy(policy, *make_pre_post_processors(config, dataset_stats=stats))


def observations(description, n, seed=0):
    rng = np.random.default_rng(seed)
    return [
        {
            key: (255 * rng.random(spec.shape)).astype(np.uint8)
            if spec.dtype == "uint8"
            else rng.standard_normal(spec.shape).astype(np.float32)
            for key, spec in description.inputs.items()
        }
        for _ in range(n)
    ]


def batch_of(window):
    """What LeRobot makes of a window (1, H, ...)."""
    tensors = {key: torch.from_numpy(value) for key, value in window.items()}
    return {
        key: value.movedim(-1, -3).float() / 255 if value.dtype == torch.uint8 else value
        for key, value in tensors.items()
    }


def check_chunks(whole, runtime):
    """The graph's chunks are those of the policy, from the same observations and numbers."""
    policy, description = whole.policy, runtime.description
    network = ExportedNetwork(policy, whole.preprocessor, acting_of(policy)).eval()
    for seed in range(3):
        seen = observations(description, description.n_obs_steps, seed)
        window = {key: np.stack([each[key] for each in seen])[None] for key in description.inputs}
        runtime.reset()
        draws = runtime._draws.take(0)
        ours = runtime.predict(window, draws)
        if description.execution.n_samples or "noise_on_the_way" in draws:
            with torch.no_grad():
                theirs = network(*map(torch.from_numpy, (*window.values(), *draws.values())))
            theirs = theirs if description.execution.n_samples else theirs[0]
        else:
            passed = {PASSED[name]: torch.from_numpy(value) for name, value in draws.items()}
            if "code_draws" in draws:
                passed["noise"] = passed["noise"][0]
            batch = whole.preprocessor(batch_of(window))
            theirs = policy.predict_action_chunk(batch, **passed)[:, : policy.config.n_action_steps]
        assert ours.shape == tuple(theirs.shape)
        assert np.abs(ours - theirs.numpy()).max() <= CLOSE * max(1.0, float(theirs.abs().max()))


@pytest.fixture(scope="module")
def exported(tmp_path_factory):
    """The policy of each case, its folder, and the runtime that has loaded it."""
    done = {}

    def get(case):
        if case.name not in done:
            whole, folder = loaded(case), tmp_path_factory.mktemp("export") / "folder"
            export(whole, folder)
            done[case.name] = whole, folder
        whole, folder = done[case.name]
        return whole, folder, load(folder, np.random.default_rng(0))

    return get


@pytest.mark.parametrize("case", FAST, ids=lambda case: case.type)
def test_the_chunks_of_every_type(case, exported):
    whole, _, runtime = exported(case)
    check_chunks(whole, runtime)
    runtime.reset()
    (seen,) = observations(runtime.description, 1)
    assert runtime.act(seen).shape == (A,)


@tiers.full_tier
@pytest.mark.parametrize(
    "case",
    [case for cases in CASES.values() for case in cases[1:]],
    ids=lambda case: f"{case.type} {case.name}",
)
def test_the_chunks_of_every_part(case, exported):
    whole, _, runtime = exported(case)
    check_chunks(whole, runtime)


def test_history_execution_units_and_limits_are_those_of_the_policy(exported):
    whole, _, runtime = exported(FAST[0])
    if runtime.description.draws:
        pytest.skip("without the policy that draws nothing")
    whole.policy.reset()
    runtime.reset()
    for seen in observations(runtime.description, 9):
        batch = whole.preprocessor(batch_of({key: value[None] for key, value in seen.items()}))
        theirs = whole.postprocessor(whole.policy.select_action(batch))[0].numpy()
        np.testing.assert_allclose(runtime.act(seen), theirs, rtol=0, atol=1e-4)
    assert runtime.limits.n_actions == 9
    assert runtime.limits.summary == whole.policy.limits.summary != ""
    assert runtime.description.actions.names == [f"joint_{dim}" for dim in range(A)]
    assert runtime.description.fps == 50.0


def test_a_robot_needs_neither_torch_nor_lerobot(exported):
    _, folder, runtime = exported(ALONE)
    program = (
        "import json, sys, numpy as np; from act_chunking_runtime.policy import load; "
        f"policy = load({str(folder)!r}, np.random.default_rng(0)); "
        "print(policy.act({'observation.state': np.zeros(6)}).tolist()); "
        f"print(json.dumps(sorted({FOREIGN} & {{*sys.modules}})))"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    action, foreign = map(json.loads, done.stdout.splitlines())
    assert foreign == []
    np.testing.assert_allclose(action, runtime.act({"observation.state": np.zeros(6)}), rtol=1e-6)


def test_what_is_drawn_follows_from_the_generator(exported):
    _, folder, _ = exported(ALONE)
    policies = [load(folder, np.random.default_rng(seed)) for seed in (0, 0, 1)]
    seen = {"observation.state": np.zeros(6)}
    first, again, _ = (policy.act(seen) for policy in policies)
    assert np.array_equal(first, again)
    here, there = (next(iter(policy._draws.take(100).values())) for policy in policies[1:])
    assert not np.array_equal(here, there)


@pytest.mark.parametrize(
    ("observation", "message"),
    [
        ({}, "the policy needs 'observation.state', but the observation has only: nothing"),
        (
            {"observation.state": np.zeros(5)},
            "'observation.state' is float64 (5,), but the policy takes float32 (6,)",
        ),
    ],
)
def test_observations_that_do_not_fit_are_refused(observation, message, exported):
    _, _, runtime = exported(ALONE)
    with pytest.raises(FeatureError) as refused:
        runtime.act(observation)
    assert str(refused.value) == message


def test_folders_that_are_not_whole_are_refused(exported, tmp_path):
    _, folder, _ = exported(ALONE)
    with pytest.raises(ConfigurationError, match=f"holds no {DESCRIPTION}: give a folder that act-chunking"):
        load(tmp_path, np.random.default_rng(0))
    text = (folder / DESCRIPTION).read_text()
    for damaged, message in (
        (text[:-9], "cannot be read"),
        (text.replace('"format": 1', '"format": 2'), "format 2, but this runtime reads 1"),
        (text.replace('"scale"', '"scales"'), "is damaged"),
        (text, f"holds no {GRAPH}: copy the whole folder"),
    ):
        (tmp_path / DESCRIPTION).write_text(damaged)
        with pytest.raises(ConfigurationError, match=message):
            load(tmp_path, np.random.default_rng(0))
    (tmp_path / GRAPH).write_bytes(b"no graph")
    with pytest.raises(ConfigurationError, match="cannot be read by ONNX Runtime"):
        load(tmp_path, np.random.default_rng(0))


def test_a_full_disk_leaves_nothing(monkeypatch, tmp_path):
    def full(*_, **__):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(exporting, "graph_of", lambda *_: b"a graph")
    monkeypatch.setattr(Path, "write_text", full)
    with pytest.raises(ConfigurationError, match=r"nothing of it was kept: .*No space left"):
        export(loaded(ALONE), tmp_path / "folder")
    assert list(tmp_path.iterdir()) == []


def test_a_graph_that_computes_something_else_is_refused(exported):
    whole, folder, _ = exported(ALONE)
    network = ExportedNetwork(whole.policy, whole.preprocessor, acting_of(whole.policy)).eval()
    examples, graph = network.examples(), (folder / GRAPH).read_bytes()
    with torch.no_grad():
        right = network(*examples.values()).numpy()
    check_graph(graph, examples, right)
    wrong = right.copy()
    wrong[..., 0] += 1e-3 * max(1.0, np.abs(right).max())
    with pytest.raises(ConfigurationError, match=r"differ from PyTorch's by 1.0e-03 .* nothing was written"):
        check_graph(graph, examples, wrong)


def test_processors_that_a_graph_cannot_hold_are_refused(tmp_path):
    class TokenizerProcessorStep:
        pass

    whole = loaded(ALONE)
    whole.preprocessor.steps.append(TokenizerProcessorStep())
    with pytest.raises(ConfigurationError, match="has the step TokenizerProcessorStep"):
        export(whole, tmp_path / "folder")
    whole = loaded(ALONE)._replace(postprocessor=lambda action: action.square())
    with pytest.raises(ConfigurationError, match="more to actions than to scale and shift them"):
        export(whole, tmp_path / "folder")


def test_what_onnx_lacks_is_what_torch_has():
    numbers = torch.cat([torch.logspace(-7, -0.31, 2000), 1 - torch.logspace(-6, -0.31, 2000)])
    torch.testing.assert_close(normal_quantile(numbers), torch.special.ndtri(numbers), rtol=1e-5, atol=1e-6)
    positive = 10 * torch.rand(10_000, generator=torch.Generator().manual_seed(0)) + 1e-3
    assert torch.equal(next_below(positive, torch.zeros(())), positive.nextafter(torch.zeros(())))
