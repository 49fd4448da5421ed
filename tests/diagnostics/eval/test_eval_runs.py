"""Episodes of an evaluation on the disk: gone on with, shared out and put together again."""

import json
from shutil import copytree

import numpy as np
import pytest
from small_policies import make_policy, save

from lerobot_act_chunking.diagnostics.core.digests import dataset_digest
from lerobot_act_chunking.diagnostics.core.environments import EnvironmentSpec
from lerobot_act_chunking.diagnostics.core.recipes import Recipe
from lerobot_act_chunking.diagnostics.eval import measuring
from lerobot_act_chunking.diagnostics.eval.diagnosis import diagnose
from lerobot_act_chunking.diagnostics.eval.settings import Settings, Shard, name_of, parse_policy, parse_shard
from lerobot_act_chunking.errors import ConfigurationError

STEPS = 7
ENVIRONMENT = EnvironmentSpec(
    "aloha_sim", {"obs_type": "state", "task": "transfer_cube", "episode_length": STEPS}
)


@pytest.fixture(scope="module")
def checkpoint(tmp_path_factory):
    return save(make_policy(), tmp_path_factory.mktemp("policy"))


@pytest.fixture(scope="module")
def other(tmp_path_factory):
    return save(make_policy(n_action_steps=3), tmp_path_factory.mktemp("other"))


def settings(folder, *checkpoints, **given):
    recipes = tuple(Recipe(f"p{place}", (each,)) for place, each in enumerate(checkpoints))
    return Settings(recipes, ENVIRONMENT, **{"episodes": 6, "batch_size": 2, "output_dir": folder, **given})


def episodes_of(report):
    return [each.episodes for each in report.results]


def test_everything_is_written_down(checkpoint, tmp_path):
    report = diagnose(settings(tmp_path, checkpoint))
    (result,) = report.results
    assert [each.seed for each in result.episodes] == list(range(1000, 1006))
    assert {each.length for each in result.episodes} == {STEPS}
    assert {each.ending for each in result.episodes} == {"truncated"}
    assert {each.network_calls for each in result.episodes} == {1}
    assert all(each.rules.keys() >= {"is_success", "success_hold"} for each in result.episodes)
    assert result.commands(3).shape == (STEPS, 14)
    info = json.loads((tmp_path / "p0" / "eval_info.json").read_text())
    assert info["overall"]["n_episodes"] == 6
    assert info["per_task"][0]["metrics"]["successes"] == [False] * 6
    assert [each["seed"] for each in info["act_chunking"]["episodes"]] == list(range(1000, 1006))


def test_the_dataset_of_the_training_is_named_with_its_digest(checkpoint, tmp_path):
    place, dataset = copytree(checkpoint, tmp_path / "policy"), tmp_path / "dataset"
    (place / "train_config.json").write_text(json.dumps({"dataset": {"repo_id": "a", "root": str(dataset)}}))
    (dataset / "meta").mkdir(parents=True)
    found = []
    for text in (None, "{}", '{"fps": 50}'):
        if text is not None:
            (dataset / "meta" / "info.json").write_text(text)
        (result,) = diagnose(settings(tmp_path / "out", str(place), episodes=2)).results
        found.append(result.dataset["sha256"])
        assert result.to_json()["dataset"]["folder"] == str(dataset)
    assert found[0] is None
    assert found[1] != found[2]
    assert found[2] == dataset_digest(dataset)
    assert diagnose(settings(tmp_path / "other", checkpoint, episodes=2)).results[0].dataset is None
    info = json.loads((tmp_path / "out" / "p0" / "eval_info.json").read_text())
    assert info["act_chunking"]["dataset"] == {"folder": str(dataset), "sha256": found[2]}


def test_finished_episodes_are_not_run_again(checkpoint, tmp_path, monkeypatch):
    first = diagnose(settings(tmp_path, checkpoint, episodes=4))
    played = []
    keep = measuring.Run.keep
    monkeypatch.setattr(measuring.Run, "keep", lambda run, n, group: (played.append(n), keep(run, n, group)))
    second = diagnose(settings(tmp_path, checkpoint, episodes=6))
    assert played == [2]
    assert episodes_of(second)[0][:4] == episodes_of(first)[0]
    assert (
        diagnose(settings(tmp_path, checkpoint, episodes=3)).results[0].episodes == episodes_of(first)[0][:3]
    )
    assert played == [2]


def test_what_is_stopped_in_the_middle_goes_on(checkpoint, tmp_path, monkeypatch):
    whole = diagnose(settings(tmp_path / "whole", checkpoint))

    def stop(done, planned):
        if done == 4:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        diagnose(settings(tmp_path / "stopped", checkpoint), stop)
    assert len(list((tmp_path / "stopped").rglob("groups/*.json"))) == 2
    assert episodes_of(diagnose(settings(tmp_path / "stopped", checkpoint))) == episodes_of(whole)


@pytest.mark.parametrize("of", [2, 3, 5])
def test_parts_of_several_machines_make_the_whole(of, checkpoint, tmp_path):
    whole = diagnose(settings(tmp_path / "whole", checkpoint))
    numbers = range(1, min(of, 3) + 1)  # there are three groups
    for number in numbers:
        part = diagnose(settings(tmp_path / f"{number}", checkpoint, shard=Shard(number, of)))
        assert not part.complete
        assert "--merge of all parts" in part.notes[0]
    parts = tuple(tmp_path / f"{number}" for number in numbers)
    merged = diagnose(settings(tmp_path / "merged", checkpoint, merge=parts), progress=pytest.fail)
    assert episodes_of(merged) == episodes_of(whole)
    np.testing.assert_array_equal(merged.results[0].commands(5), whole.results[0].commands(5))


def test_a_part_without_episodes_is_refused(checkpoint, tmp_path):
    with pytest.raises(ConfigurationError, match="--shard=5/5 has no episode: 6 episodes are 3 groups"):
        diagnose(settings(tmp_path, checkpoint, shard=Shard(5, 5)))


@pytest.mark.slow
def test_workers_change_nothing(checkpoint, other, tmp_path):
    alone = diagnose(settings(tmp_path / "alone", checkpoint, other))
    shared = diagnose(settings(tmp_path / "shared", checkpoint, other, workers=2))
    assert episodes_of(shared) == episodes_of(alone)


def test_batches_change_nothing_but_rounding(checkpoint, tmp_path):
    one, six = (
        diagnose(settings(tmp_path / f"{size}", checkpoint, batch_size=size)).results[0] for size in (1, 6)
    )
    for place in range(6):
        np.testing.assert_allclose(one.commands(place), six.commands(place), atol=1e-5)
    assert [each.seed for each in one.episodes] == [each.seed for each in six.episodes]


@pytest.mark.parametrize(
    ("changed", "named"),
    [({"seed": 5}, "seed"), ({"batch_size": 3}, "batch_size"), ({"environment": None}, "environment")],
)
def test_a_folder_is_of_one_question(changed, named, checkpoint, tmp_path):
    diagnose(settings(tmp_path, checkpoint))
    if "environment" in changed:
        longer = {**ENVIRONMENT.arguments, "episode_length": STEPS + 1}
        changed = {"environment": EnvironmentSpec("aloha_sim", longer)}
    recipes = (Recipe("p0", (checkpoint,)),)
    given = {"environment": ENVIRONMENT, "episodes": 6, "batch_size": 2, "output_dir": tmp_path, **changed}
    with pytest.raises(ConfigurationError, match=f"episodes of another {named}: choose another --output-dir"):
        diagnose(Settings(recipes, **given))


def test_another_checkpoint_under_the_same_name_is_refused(checkpoint, other, tmp_path):
    diagnose(settings(tmp_path, checkpoint))
    with pytest.raises(ConfigurationError, match="episodes of another checkpoint"):
        diagnose(settings(tmp_path, other))
    with pytest.raises(ConfigurationError, match="episodes of another checkpoint"):
        diagnose(settings(tmp_path / "new", other, merge=(tmp_path,)))


@pytest.mark.parametrize("name", ["groups/00001.json", "question.json"])
def test_damaged_files_are_named(name, checkpoint, tmp_path):
    diagnose(settings(tmp_path, checkpoint))
    (tmp_path / "p0" / name).write_text("{")
    with pytest.raises(ConfigurationError, match=f"{name} cannot be read"):
        diagnose(settings(tmp_path, checkpoint))


def test_the_folder_follows_from_the_question(checkpoint, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    first = diagnose(settings(None, checkpoint, episodes=2))
    assert first.folder.parent.as_posix() == "outputs/eval"
    assert diagnose(settings(None, checkpoint, episodes=2)).folder == first.folder
    assert diagnose(settings(None, checkpoint, episodes=2, seed=7)).folder != first.folder


def test_each_draw_has_noise_of_its_own(tmp_path):
    sampling = make_policy(action_likelihood="gaussian", action_temperature=1.0)
    recipes = (Recipe("it", (save(sampling, tmp_path / "policy"),)),)
    asked = Settings(recipes, ENVIRONMENT, episodes=1, draws=2, output_dir=tmp_path / "out")
    one, other = diagnose(asked).results
    assert (one.commands(0) != other.commands(0)).any()


def test_trainings_and_draws_are_kept_apart(checkpoint, other, tmp_path):
    recipes = (Recipe("both", (checkpoint, other)),)
    report = diagnose(Settings(recipes, ENVIRONMENT, episodes=2, batch_size=2, draws=2, output_dir=tmp_path))
    assert [each.run.title for each in report.results] == [
        f"both, training {training}, draw {draw}" for training in (1, 2) for draw in (1, 2)
    ]
    assert (tmp_path / "both" / "training_2" / "draw_1" / "eval_info.json").exists()
    assert "All draws of both are the same" in " ".join(report.notes)
    (recipe,) = report.recipes
    assert recipe.places == tuple(
        str(tmp_path / "both" / f"training_{training}" / "draw_1" / "eval_info.json") for training in (1, 2)
    )


def test_deciding_stops_as_soon_as_it_is_known(checkpoint, other, tmp_path, monkeypatch):
    def outcome(run):
        return [run.name == "p0"] * 40

    monkeypatch.setattr(
        measuring.Results, "successes", lambda results, run: outcome(run)[: len(results.of(run))]
    )
    report = diagnose(settings(tmp_path, checkpoint, other, episodes=40, batch_size=4, until_decided=True))
    assert report.decision.decided
    assert report.exit_code == 0
    assert report.decision.episodes == 12
    assert "p0 succeeds most often: decided after 12 of at most 40 episodes each" in report.reasons[-1]


def test_undecided_is_said(checkpoint, other, tmp_path):
    report = diagnose(settings(tmp_path, checkpoint, other, episodes=4, until_decided=True))
    assert (report.verdict, report.exit_code) == ("inconclusive", 10)
    assert "not decided after 4 of at most 4 episodes each" in report.reasons[-1]


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"episodes": 0}, "episodes=0 must be at least 1"),
        ({"batch_size": 0}, "batch_size=0 must be at least 1"),
        ({"draws": 0}, "draws=0 must be at least 1"),
        ({"videos": -1}, "videos=-1 must be at least 0"),
        ({"until_decided": True}, "compares policies: give two or more"),
    ],
)
def test_numbers_that_make_no_sense(given, message):
    with pytest.raises(ConfigurationError, match=message):
        Settings((Recipe("a", ("x",)),), ENVIRONMENT, **given)


@pytest.mark.parametrize(
    ("recipes", "given", "message"),
    [
        ((), {}, "eval takes a checkpoint or more"),
        ((("a", ("x",)), ("a", ("y",))), {}, "2 policies are named a"),
        ((("a", ("x",)), ("b", ("x",))), {}, "x is given 2 times"),
        ((("a", ("x", "y")), ("b", ("z",))), {"until_decided": True}, "a has several training seeds"),
        ((("a", ("x",)), ("b", ("z",))), {"until_decided": True, "draws": 2}, "leave out --draws"),
        ((("a", ("x",)), ("b", ("z",))), {"until_decided": True, "shard": Shard(1, 2)}, "leave out --shard"),
    ],
)
def test_policies_that_cannot_be_compared(recipes, given, message):
    with pytest.raises(ConfigurationError, match=message):
        Settings(tuple(Recipe(*each) for each in recipes), ENVIRONMENT, **given)


@pytest.mark.parametrize(
    ("checkpoint", "name"),
    [
        ("outputs/train/act/checkpoints/last/pretrained_model", "act"),
        ("outputs/train/act/checkpoints/005000/pretrained_model", "act-005000"),
        ("outputs/train/act/checkpoints/last", "act"),
        ("checkpoints/last/pretrained_model", "checkpoint"),
        ("lerobot/diffusion_pusht", "diffusion_pusht"),
        ("./mine", "mine"),
    ],
)
def test_names_of_checkpoints(checkpoint, name):
    assert name_of(checkpoint) == name
    assert parse_policy(checkpoint).name == name
    assert parse_policy(f"x={checkpoint},b") == Recipe("x", (checkpoint, "b"))


def test_an_evaluation_is_no_checkpoint():
    with pytest.raises(ConfigurationError, match="act-chunking compare reads it"):
        parse_policy("act=outputs/eval/act/eval_info.json")


def test_a_part_that_is_not_there_is_refused(checkpoint, tmp_path):
    with pytest.raises(ConfigurationError, match=r"--merge=.*part holds no evaluation of p0: give the"):
        diagnose(settings(tmp_path / "out", checkpoint, merge=(tmp_path / "part",)))
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("text", ["0/2", "3/2", "1", "a/b", "1/0"])
def test_parts_that_there_are_not(text):
    with pytest.raises(ConfigurationError, match="--shard"):
        parse_shard(text)
