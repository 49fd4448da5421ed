"""All tokenizers on one dataset."""

import io
import json

import numpy as np
import pytest
from rich.console import Console

from lerobot_act_chunking.data.timing import ChunkTiming
from lerobot_act_chunking.diagnostics.codebook.comparison import measuring
from lerobot_act_chunking.diagnostics.codebook.comparison.candidates import Candidate, candidates_for
from lerobot_act_chunking.diagnostics.codebook.comparison.measuring import compare
from lerobot_act_chunking.diagnostics.codebook.comparison.plots import plot_report
from lerobot_act_chunking.diagnostics.codebook.comparison.terminal import print_report
from lerobot_act_chunking.diagnostics.codebook.settings import Thresholds
from lerobot_act_chunking.diagnostics.core.episodes import ActionEpisodes
from lerobot_act_chunking.errors import ConfigurationError, DatasetError
from lerobot_act_chunking.tokenizers.make import check_tokenizer

C = 5
SMALL = [
    Candidate({"tokenizer": "residual_vq", "vqvae_num_layers": 2, "vqvae_n_embed": 8}),
    Candidate({"tokenizer": "dct", "dct_coefficients": 2, "n_bins": 33}),
    Candidate({"tokenizer": "uniform", "n_bins": 64}),
]


def waves(n=5, length=60):
    rng = np.random.default_rng(0)
    steps = np.arange(length)[:, None]
    made = {}
    for episode in range(n):
        phase, height = rng.uniform(0, 6, 2), rng.uniform(1, 3)
        made[episode] = (10 + height * np.sin(0.1 * steps + phase)).astype(np.float32)
    return ActionEpisodes("waves", 20.0, ("x", "y"), made)


def compared(data=None, *, steps=30, allowed=0.1, **options):
    return compare(
        data or waves(), ChunkTiming(1, C), Thresholds.with_max_lost(allowed), steps=steps, **options
    )


@pytest.fixture(scope="module")
def report():
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(measuring, "candidates_for", lambda chunk_size: SMALL)
        return compared()


def test_costs_and_losses(report):
    learned, waved, binned = report.fitted
    assert [each.tokens for each in report.fitted] == [2, 4, 10]
    assert [each.bits for each in report.fitted] == pytest.approx([6, 4 * np.log2(33), 60])
    assert all(0 < each.entropy_bits <= each.bits for each in report.fitted)
    assert report.held_out == [4]
    spread = np.concatenate([report.demonstrations.episodes[e] for e in range(4)])
    half = (spread.max(0) - spread.min(0)) / 2
    assert all(loss.p95 < 1.2 * h / 64 for loss, h in zip(binned.losses.dimensions, half, strict=True))
    assert binned.losses.lost_variance < waved.losses.lost_variance < learned.losses.lost_variance
    assert learned.seconds > binned.seconds


def test_the_fewest_bits_that_are_good_enough(report):
    for allowed in (0.9, 0.01):
        best, judgement = measuring._recommend(report.fitted, allowed)
        enough = [each for each in report.fitted if each.losses.lost_variance <= allowed]
        assert best is min(enough, key=lambda each: each.bits)
        assert judgement.verdict == ("pass" if best.candidate.kind == "residual_vq" else "warn")
        assert best.candidate.name in judgement.reasons[0]
    assert f"get all {best.tokens} of its codes right" in judgement.reasons[1]
    assert "residual_vq 2 x 8, loses" in judgement.reasons[1]
    assert measuring._recommend(report.fitted[1:], 0.01)[1].verdict == "pass"
    best, judgement = measuring._recommend(report.fitted, 1e-9)
    assert best.candidate.kind == "uniform"
    assert judgement.verdict == "fail"
    assert "choose shorter chunks or more --steps" in judgement.reasons[0]


def test_what_is_written(report, tmp_path):
    content = json.loads(report.write(tmp_path / "new" / "a.json").read_text(), parse_constant=pytest.fail)
    assert [each["name"] for each in content["tokenizers"]] == [
        "residual_vq 2 x 8",
        "dct 2, 33 bins",
        "uniform 64 bins",
    ]
    assert content["tokenizers"][1]["dct_coefficients"] == 2
    assert content["recommended"]["flags"].endswith("--policy.chunk_size=5 --policy.chunk_stride=1")
    assert plot_report(report, tmp_path / "a.png").read_bytes().startswith(b"\x89PNG")
    console = Console(width=100, record=True, file=io.StringIO())
    print_report(report, console)
    printed = " ".join(console.export_text().split())
    assert "Tokenizers for 5 actions, 0.25 s (waves)" in printed
    assert "fitted to 4 episodes (30 steps, if at all), errors on 1 others" in printed
    assert f"recommended: {report.flags}" in printed
    assert "mean over the dimensions, then that of the worst. " in printed


def test_dimensions_that_stand_still_are_no_part_of_what_is_lost(monkeypatch):
    monkeypatch.setattr(measuring, "candidates_for", lambda chunk_size: SMALL[1:])
    data = waves()
    still = {episode: np.pad(actions, ((0, 0), (0, 1))) for episode, actions in data.episodes.items()}
    console = Console(width=100, record=True, file=io.StringIO())
    print_report(compared(ActionEpisodes("waves", 20.0, ("x", "y", "z"), still)), console)
    printed = " ".join(console.export_text().split())
    assert "mean over the 2 of 3 dimensions that move, then that of the worst." in printed


def test_the_same_seed_fits_alike(monkeypatch):
    monkeypatch.setattr(measuring, "candidates_for", lambda chunk_size: SMALL[:1])
    seen = []
    runs = [
        compared(seed=seed, steps=5, watch=lambda each: seen.append(len(each)) or each) for seed in (0, 0, 1)
    ]
    first, again, other = (run.fitted[0].losses for run in runs)
    assert first == again
    assert first != other
    assert seen == [1, 1, 1]


def test_training_helps(monkeypatch):
    monkeypatch.setattr(measuring, "candidates_for", lambda chunk_size: SMALL[:1])
    little, more = (compared(steps=steps).fitted[0].losses.lost_variance for steps in (1, 60))
    assert more < 0.7 * little


def test_candidates_follow_the_chunk():
    names = [candidate.name for candidate in candidates_for(20)]
    assert "dct 2, 65 bins" in names
    assert "dct 5, 65 bins" in names
    assert len(names) == len(set(names))
    assert len(candidates_for(4)) == len(names) - 1  # both counts of coefficients are 1
    for candidate in candidates_for(20):
        check_tokenizer(candidate.spec(20, 3))


def test_flags():
    fsq = Candidate({"tokenizer": "fsq", "vqvae_num_layers": 2, "fsq_levels": (3, 4)})
    assert fsq.flags == "--policy.tokenizer=fsq --policy.vqvae_num_layers=2 --policy.fsq_levels=[3,4]"


def test_what_cannot_be_compared():
    with pytest.raises(DatasetError, match="waves has 1 episode: it takes 2"):
        compared(waves(1))
    with pytest.raises(ConfigurationError, match="steps=0 must be at least 1"):
        compared(steps=0)


def test_nothing_is_fitted_to_what_is_held_out():
    seen, held_out = measuring._split(waves(10))
    assert list(seen.episodes) == list(range(8))
    assert list(held_out.episodes) == [8, 9]
